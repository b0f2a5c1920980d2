"""From where a request may come: the names under which the panel is served, and the pages that it serves itself.

A page of a stranger that makes a name of its own point to this machine (DNS rebinding) has another Host; a page of a
stranger that opens a WebSocket to us has another Origin.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def hosts(bound: str, others: Iterable[str], port: int, *, tls: bool) -> frozenset[str]:
    """Return the values of the Host header that are served.

    Args:
        bound: Address or name to which the server is bound.
        others: Further names and addresses of this machine.
        port: Where it listens.
        tls: Whether it speaks TLS, whose usual port stands in no Host header; likewise without.
    """
    names = {*LOOPBACK, *others}
    if bound not in ("0.0.0.0", "::", ""):
        names.add(bracketed(bound))
    usual = 443 if tls else 80
    served = {f"{name.lower()}:{port}" for name in map(bracketed, names)}
    return frozenset(served | ({bracketed(name).lower() for name in names} if port == usual else set()))


def bracketed(host: str) -> str:
    """Return a host as it stands in an address: IPv6 in brackets."""
    try:
        return f"[{host}]" if ipaddress.ip_address(host).version == 6 else host
    except ValueError:
        return host


def host_allowed(host: str | None, served: frozenset[str]) -> bool:
    """Whether a request's Host is one of ours."""
    return host is not None and host.lower() in served


def origin_allowed(origin: str | None, host: str, *, tls: bool) -> bool:
    """Whether a request comes from a page that was served under the same Host.

    Args:
        origin: Of the request; None: it has none.  Browsers send it with every WebSocket and every POST.
        host: Host of the request, which is allowed.
        tls: Whether the server speaks TLS.
    """
    return origin is not None and origin.lower() == f"{'https' if tls else 'http'}://{host.lower()}"
