"""The thread that serves: a loop of its own beside the executor, from the socket to the printed address."""

from __future__ import annotations

import asyncio
import errno
import io
import socket
import ssl
import threading
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from aiohttp import web

from calibration.background import in_loop
from calibration_core.errors import InputError

NEXT = 20  # ports that are tried
ENDING = 3.0  # s of wall time, that open connections have to end


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
            one.listen(64)
        except OSError as error:
            one.close()
            if error.errno != errno.EADDRINUSE or port >= last:
                raise
            port += 1
        else:
            return one


def tls_context(certificate: str, key: str) -> ssl.SSLContext | None:
    """Return how TLS is spoken; None without a certificate.

    Raises:
        InputError: Certificate or key cannot be used, or one is given without the other.
    """
    if not certificate and not key:
        return None
    if not certificate or not key:
        raise InputError(
            "panel", "tls_key" if certificate else "tls_certificate", "nothing", "certificate and key, or neither"
        )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key)
    except OSError as error:  # also what ssl raises
        raise InputError(certificate, "", str(error), f"a certificate (PEM) that fits the key {key}") from error
    return context


def printed(url: str) -> str:
    """Return an address for the terminal: as text, and as a QR code for a tablet's camera."""
    import segno

    drawn = io.StringIO()
    segno.make(url, error="l").terminal(out=drawn, compact=True, border=2)
    return (
        f"operator's panel: {url}\n(good for one device; the next address is shown once it is used)\n{drawn.getvalue()}"
    )


class Serving:
    """Serves an application in a thread of its own."""

    def __init__(
        self,
        application: web.Application,
        taken: socket.socket,
        tls: ssl.SSLContext | None,
        ending: Callable[[], Awaitable[None]],
    ) -> None:
        """Prepare.

        Args:
            application: What is served.
            taken: The socket that listens.
            tls: How TLS is spoken; None: it is not.
            ending: Called in the thread when it ends.
        """
        self._application, self._socket, self._tls, self._ending = application, taken, tls, ending
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
            self._application, access_log=None, handle_signals=False, shutdown_timeout=0.5, handler_cancellation=True
        )
        await runner.setup()
        site = web.SockSite(runner, self._socket, ssl_context=self._tls)
        await site.start()
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
