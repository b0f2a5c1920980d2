"""Long work beside the callbacks: in a plain thread, awaited by the callback that started it.

An executor with one thread carries the streams; whoever waits must not hold it.  A coroutine callback that awaits a
`Background` gives the thread back and is resumed when the work is done.  Its callback group must be reentrant, or the
callbacks of the same group would wait as well.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Generator
from typing import Any, Generic, TypeVar

from rclpy.node import Node

T = TypeVar("T")
Until = Callable[[Callable[[], bool], float], bool]
"""Waits for a condition, at most so many s of wall time; returns whether it came true."""
LOOK = 0.005  # s of wall time, between two looks at what is waited for


def in_executor(node: Node, work: Callable[[], object]) -> None:
    """Do something short in the thread that spins a node; at once where nobody spins it.

    An action client files a goal only after it was sent: an answer that another thread takes in between is lost.
    """
    executor = node.executor
    if executor is None:
        work()
    else:
        executor.create_task(work)


def in_loop(loop: asyncio.AbstractEventLoop, work: Callable[[], object]) -> None:
    """Do something short in the thread of a loop; nothing where the loop has ended, also while this is called."""
    try:
        loop.call_soon_threadsafe(work)
    except RuntimeError:
        if not loop.is_closed():
            raise


def wait_until(condition: Callable[[], bool], seconds: float) -> bool:
    """Wait, in a thread that is not the executor's, at most so many s of wall time; return whether it came true."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(LOOK)
    return True


def called(client: Any, request: Any, seconds: float, until: Until = wait_until) -> Any:
    """Call a service from a thread that is not the executor's.

    Args:
        client: Of the service.
        request: What is asked.
        seconds: Of wall time, that its server may take to appear, and to answer then.
        until: Waits; it may raise when nobody wants the answer any more.

    Returns:
        The answer; None if none comes in time.
    """
    if not until(client.service_is_ready, seconds):
        return None
    future = client.call_async(request)
    try:
        return future.result() if until(future.done, seconds) else None
    finally:
        client.remove_pending_request(future)


class Background(Generic[T]):
    """One piece of work in a thread of its own.

    Example:
        result = await Background(node, lambda: slow(request))
    """

    def __init__(self, node: Node, work: Callable[[], T]) -> None:
        """Start the work.

        Args:
            node: The node whose executor is woken at the end.
            work: What to do; what it raises is raised where the result is awaited.
        """
        self._node = node
        self._result: list[T] = []
        self._error: BaseException | None = None
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(work,), name="background", daemon=True)
        self._thread.start()

    def _run(self, work: Callable[[], T]) -> None:
        try:
            self._result.append(work())
        except BaseException as error:  # noqa: BLE001  # handed over to the one who awaits
            self._error = error
        self._done.set()
        executor = self._node.executor
        if executor is not None:
            executor.wake()

    def __await__(self) -> Generator[None, None, T]:
        """Give the executor back until the work is done."""
        while not self._done.is_set():
            yield
        if self._error is not None:
            raise self._error
        return self._result[0]
