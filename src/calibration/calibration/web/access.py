"""Who may see the panel, from where, and who holds control: tokens, sessions, one operator at a time, rate limits.

Times are s of a steady clock.  Nothing here knows about the network or about ROS.  Sessions outlive the process in a
file that holds no secret: of a cookie its hash alone, and the page's own token follows from the cookie.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import hmac
import ipaddress
import json
import os
import secrets
import tempfile
from collections.abc import Iterable
from pathlib import Path

IDLE = 12 * 3600.0  # s, a shift: a session that nobody uses for so long has ended
TOKEN_LIFE = 12 * 3600.0  # s, that a token which nobody has used is good for
ABSENT = 5.0  # s without an open page, after which control may be taken without asking
MOST_SESSIONS = 16
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
EVERY = ("0.0.0.0", "::", "")  # addresses to listen at that no page is reached under


@dataclasses.dataclass(eq=False)
class Session:
    """One page that has entered.

    Attributes:
        key: Hash of the cookie that the browser sends with every request.
        name: Of the operator, as entered.
        address: From where the page entered.
        used: When it was last used.
        pages: Open connections.
        left: When the last one was closed.
    """

    key: str
    name: str
    address: str
    used: float
    pages: int = 0
    left: float = 0.0


def hashed(cookie: str) -> str:
    """Return what is kept of a cookie."""
    return hashlib.sha256(cookie.encode()).hexdigest()


def page_token(cookie: str) -> str:
    """Return the secret that a page sends with every request that changes something: its scripts see no cookie."""
    return hmac.new(cookie.encode(), b"page", hashlib.sha256).hexdigest()


class Access:
    """Tokens and sessions.

    Attributes:
        token: The present token; whoever enters with it uses it up, and the next one is drawn.
        sessions: Those that have entered, by key.
    """

    def __init__(self, now: float) -> None:
        self.sessions: dict[str, Session] = {}
        self._draw(now)

    def _draw(self, now: float) -> None:
        self.token, self._drawn = secrets.token_urlsafe(24), now

    def enter(self, token: str, name: str, address: str, now: float) -> tuple[str, Session] | None:
        """Return cookie and session, None where the token is not the present one; a token is good for one entry."""
        right = hmac.compare_digest(token.encode(), self.token.encode())
        if now - self._drawn > TOKEN_LIFE:
            self._draw(now)
            return None
        if not right:
            return None
        self._draw(now)
        if len(self.sessions) >= MOST_SESSIONS:
            oldest = min(self.sessions.values(), key=lambda one: (one.pages > 0, one.used))
            del self.sessions[oldest.key]
        cookie = secrets.token_urlsafe(32)
        session = Session(hashed(cookie), name, address, now, left=now)
        self.sessions[session.key] = session
        return cookie, session

    def find(self, cookie: str, now: float) -> Session | None:
        """Return the session of a cookie, None where there is none, or it has ended."""
        return self.used(self.sessions.get(hashed(cookie)), now)

    def used(self, session: Session | None, now: float) -> Session | None:
        """Take notice that a session is used; return it, None where there is none, or it has ended."""
        if session is None or self.sessions.get(session.key) is not session:
            return None
        if now - session.used > IDLE and not session.pages:
            del self.sessions[session.key]
            return None
        session.used = now
        return session

    def leave(self, session: Session) -> None:
        """End a session."""
        self.sessions.pop(session.key, None)

    def kept(self, now: float, wall: float) -> str:
        """Return the sessions as text, to be kept for the next process; `wall` is s of the clock on the wall."""
        rows = [{"key": one.key, "name": one.name, "address": one.address,
                 "used": wall if one.pages else wall - now + one.used} for one in self.sessions.values()]  # fmt: skip
        return json.dumps(rows, indent=1)

    def restore(self, text: str, now: float, wall: float) -> None:
        """Take back the sessions that were kept, but those that have ended meanwhile.

        Raises:
            ValueError: The text is not what `kept` returns.
        """
        try:
            for row in json.loads(text):
                idle = max(wall - float(row["used"]), 0.0)
                if idle <= IDLE and len(self.sessions) < MOST_SESSIONS:
                    key = str(row["key"])
                    self.sessions[key] = Session(key, str(row["name"]), str(row["address"]), now - idle, left=now)
        except (KeyError, TypeError) as error:
            raise ValueError(str(error)) from error


def write_private(path: Path, text: str) -> None:
    """Write a file that its user alone can read, as a whole or not at all.

    Raises:
        OSError: It cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    number, name = tempfile.mkstemp(dir=path.parent, prefix=path.name)  # for its user alone from the beginning
    try:
        with os.fdopen(number, "w", encoding="utf-8") as file:
            file.write(text)
        Path(name).replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        raise


class Control:
    """Which session holds control; the others watch.

    Attributes:
        holder: Who holds it; None: nobody.
        asking: Who asks for it, and waits for the holder's answer.
    """

    def __init__(self) -> None:
        self.holder: Session | None = None
        self.asking: Session | None = None

    def ask(self, session: Session, now: float) -> bool:
        """Ask for control; return whether it was given at once: nobody holds it, or the holder's page is gone."""
        holder = self.holder
        if holder is None or holder is session or (not holder.pages and now - holder.left >= ABSENT):
            self.holder, self.asking = session, None
            return True
        self.asking = session
        return False

    def answer(self, session: Session, *, give: bool) -> bool:
        """Give control to who asks, or keep it; return whether the session had it to give."""
        if session is not self.holder or self.asking is None:
            return False
        if give:
            self.holder = self.asking
        self.asking = None
        return True

    def release(self, session: Session) -> None:
        """Give control back, or stop asking."""
        if session is self.holder:
            self.holder, self.asking = self.asking, None
        elif session is self.asking:
            self.asking = None


class Rate:
    """So many things a second, with a reserve; each key has its own."""

    def __init__(self, per_second: float, reserve: float) -> None:
        self._rate, self._reserve = per_second, reserve
        self._left: dict[str, tuple[float, float]] = {}

    def take(self, key: str, now: float) -> bool:
        """Return whether one more is allowed now; it is counted if it is."""
        left, since = self._left.get(key, (self._reserve, now))
        left = min(self._reserve, left + (now - since) * self._rate)
        if left < 1.0:
            self._left[key] = (left, now)
            return False
        self._left[key] = (left - 1.0, now)
        self._forget(now)
        return True

    def _forget(self, now: float) -> None:
        """Drop keys whose reserve is full again: strangers cannot fill the memory."""
        if len(self._left) > 1000:
            full = self._reserve / self._rate
            self._left = {key: one for key, one in self._left.items() if now - one[1] < full}


def origins(bound: str, others: Iterable[str], port: int) -> frozenset[str]:
    """Return the origins of our own pages, as browsers state them.

    Args:
        bound: Address or name to which the server is bound.
        others: Further names of this machine; with `http://` or `https://` the whole origin, as of a reverse proxy.
        port: Where the server listens.
    """
    names = {*LOOPBACK, *others, *(() if bound in EVERY else (bound,))}
    at = "" if port == 80 else f":{port}"  # a usual port stands in no origin
    return frozenset((one if "://" in one else f"http://{bracketed(one)}{at}").rstrip("/").lower() for one in names)


def bracketed(host: str) -> str:
    """Return a host as it stands in an address: IPv6 in brackets."""
    try:
        return f"[{host}]" if ipaddress.ip_address(host).version == 6 else host
    except ValueError:
        return host


def host_allowed(host: str | None, own: frozenset[str]) -> bool:
    """Whether a request's Host is one of ours: a stranger's name that points here (DNS rebinding) is another one."""
    return host is not None and host.lower() in {one.partition("://")[2] for one in own}


def origin_allowed(origin: str | None, host: str, own: frozenset[str]) -> bool:
    """Whether a request comes from a page of ours that was served under the same Host.

    Args:
        origin: Of the request; None: it has none.  Browsers send it with every WebSocket and every POST.
        host: Host of the request.
        own: Origins of our own pages.
    """
    return origin is not None and origin.lower() in own and origin.lower().partition("://")[2] == host.lower()
