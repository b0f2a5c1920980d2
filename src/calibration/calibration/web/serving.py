"""The thread that serves: a loop of its own beside the executor, from the socket to the printed address.

Connections that show no session are bounded in number and in time, whoever opens them and whatever they send.
"""

from __future__ import annotations

import asyncio
import collections
import errno
import io
import socket
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from typing import Any

from aiohttp import web

from calibration.web.hub import in_loop

NEXT = 20  # ports that are tried
ENDING = 3.0  # s of wall time, that open connections have to end
WAITING = 256  # connections that the system keeps until they are let in
# Connections that show no session: a browser opens 6 to a server, and a process may usually hold 1,024 files.
STRANGERS_OF_ADDRESS = 200
STRANGERS = 400
STRANGER = 15.0  # s of wall time, that one may stay: the whole page (0.4 MB) comes in 4 s at 1 Mbit/s
IDLE = 75.0  # s, that a connection with a session may wait for its next request
LOOK = 1.0  # s between two looks at those that have stayed too long
REPORTED = 60.0  # s between two lines in the log about them
QUIETLY = 20  # closed between two lines: a browser opens some that it never uses


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens at a port, or at the next one that is free.

    Raises:
        OSError: The host is not one of this machine, or all ports are taken.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    last = port + NEXT if port else port
    while True:
        one = socket.socket(family, socket.SOCK_STREAM)
        try:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            one.bind((host, port))
            one.listen(WAITING)
        except OSError as error:
            one.close()
            if error.errno != errno.EADDRINUSE or port >= last:
                raise
            port += 1
        else:
            return one


def printed(url: str) -> str:
    """Return an address for the terminal: as text, and as a QR code for a tablet's camera."""
    import segno

    drawn = io.StringIO()
    segno.make(url, error="l").terminal(out=drawn, compact=True, border=2)
    return (
        f"operator's panel: {url}\n(good for one device; the next address is shown once it is used)\n{drawn.getvalue()}"
    )


class _Connection:
    """One connection: from where it comes, since when it is open, and whether a request of it has shown a session."""

    def __init__(self, address: str, opening: asyncio.Task[Any]) -> None:
        self.address, self.since, self.known = address, time.monotonic(), False
        self.transport: asyncio.Transport | None = None
        self._opening, self._failed = opening, False
        opening.add_done_callback(self._opened)

    def _opened(self, opening: asyncio.Task[Any]) -> None:
        if opening.cancelled() or opening.exception() is not None:  # the handshake failed, or it has gone again
            self._failed = True
        else:
            self.transport = opening.result()[0]

    @property
    def closed(self) -> bool:
        """Whether it is open no more."""
        return self._failed or (self.transport is not None and self.transport.is_closing())

    def close(self) -> None:
        """Close it at once."""
        self._opening.cancel()
        if self.transport is not None:
            self.transport.abort()


class Door:
    """Lets connections in.  A newcomer is never refused: the oldest that has shown no session makes room for it."""

    def __init__(self, say: Callable[[str], None]) -> None:
        """Prepare.

        Args:
            say: Takes a line for the log, one in `REPORTED` seconds; called in the loop's thread.
        """
        self._say = say
        self._connections: list[_Connection] = []
        self._shut: collections.Counter[str] = collections.Counter()  # by address, since the last line
        self._reported = time.monotonic()

    def known(self, transport: asyncio.BaseTransport | None) -> None:
        """Take notice that a request of a connection has shown a session."""
        for one in self._connections:
            if one.transport is transport:
                one.known = True

    async def serve(self, taken: socket.socket, protocol: Callable[[], Any]) -> None:
        """Let connections in until this is cancelled; the socket is closed then."""
        loop = asyncio.get_running_loop()
        watching = loop.create_task(self._watch())
        taken.setblocking(False)
        try:
            while True:
                try:
                    one, peer = await loop.sock_accept(taken)
                except OSError:  # no file is left for it, or it has gone again
                    self._close(self._strangers()[:1])
                    await asyncio.sleep(LOOK)
                    continue
                opening = loop.connect_accepted_socket(protocol, one)
                self._connections.append(_Connection(str(peer[0]), loop.create_task(opening)))
                if len(self._connections) > STRANGERS_OF_ADDRESS:
                    self._make_room(str(peer[0]))
                await asyncio.sleep(0.0)  # a connection that waits already is taken without a turn for the open pages
        finally:
            watching.cancel()
            taken.close()

    def _strangers(self) -> list[_Connection]:
        """Return those that have shown no session, the oldest first."""
        self._connections = [one for one in self._connections if not one.closed]
        return [one for one in self._connections if not one.known]

    def _make_room(self, address: str) -> None:
        strangers = self._strangers()
        near = [one for one in strangers if one.address == address]
        self._close(near[: max(len(near) - STRANGERS_OF_ADDRESS, 0)] or strangers[: max(len(strangers) - STRANGERS, 0)])

    def _close(self, connections: Iterable[_Connection]) -> None:
        for one in connections:
            one.close()
            self._shut[one.address] += 1

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(LOOK)
            now = time.monotonic()
            self._close(one for one in self._strangers() if now - one.since > STRANGER)
            if now - self._reported < REPORTED:
                continue
            if self._shut.total() > QUIETLY:
                address, most = self._shut.most_common(1)[0]
                closed = f"closed {self._shut.total()} connections that showed no session"
                self._say(f"{closed}, {most} of them from {address}: look at what opens them there")
            self._shut.clear()
            self._reported = now


class Serving:
    """Serves an application in a thread of its own."""

    def __init__(
        self,
        application: web.Application,
        taken: socket.socket,
        ending: Callable[[], Awaitable[None]],
        door: Door,
    ) -> None:
        """Prepare.

        Args:
            application: What is served.
            taken: The socket that listens; it is closed at the end.
            ending: Called in the thread when it ends.
            door: Lets connections in.
        """
        self._application, self._socket, self._ending = application, taken, ending
        self._door = door
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name="panel", daemon=True)
        self._stop = asyncio.Event()
        self._ready = threading.Event()
        self._tasks: set[asyncio.Task[Any]] = set()

    def start(self) -> None:
        """Begin, and wait until pages are served."""
        self._thread.start()
        self._ready.wait(ENDING)

    def stop(self) -> None:
        """End."""
        if self._thread.is_alive():
            in_loop(self._loop, self._stop.set)
            self._thread.join(2.0 * ENDING)

    def do(self, work: Callable[[], object]) -> None:
        """Have something short done in the thread; nothing once it has ended."""
        in_loop(self._loop, work)

    def begin(self, work: Coroutine[Any, Any, Any]) -> None:
        """Begin a coroutine; to be called in the thread."""
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _serve(self) -> None:
        try:
            self._loop.run_until_complete(self._until_stopped())
        finally:
            self._loop.close()

    async def _until_stopped(self) -> None:
        runner = web.AppRunner(
            self._application, access_log=None, handle_signals=False, shutdown_timeout=0.5, handler_cancellation=True,
            keepalive_timeout=IDLE, lingering_time=LOOK,
        )  # fmt: skip
        await runner.setup()
        assert runner.server is not None  # noqa: S101 - it was set up
        self.begin(self._door.serve(self._socket, runner.server))
        self._ready.set()
        await self._stop.wait()
        await self._ending()
        for task in self._tasks:
            task.cancel()
        await runner.cleanup()
        await self._end_tasks()

    async def _end_tasks(self) -> None:
        """End whatever is still under way: a task that its loop leaves behind is never ended."""
        end = self._loop.time() + ENDING
        while (rest := asyncio.all_tasks() - {asyncio.current_task()}) and (left := end - self._loop.time()) > 0.0:
            for task in rest:
                task.cancel()
            await asyncio.wait(rest, timeout=left)  # in the meantime others may have been begun
