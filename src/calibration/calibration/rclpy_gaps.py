"""All that the suite uses of the inside of rclpy, and what it has to do because rclpy does not; a test for each.

An executor with one thread carries the streams; whoever waits must not hold it.  A coroutine callback that awaits a
`Background` gives the thread back and is resumed when the work is done.  Its callback group must be reentrant, or the
callbacks of the same group would wait as well.

An executor that is woken for every sample of a fast stream does little else.  `Waiting` never wakes it: what has come
is taken on the tick of whoever listens.  An executor that was held up runs its timers first, and what waits meanwhile
after them: whoever decides by a timer how old a message is has to take what waits himself, or it would look late.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any, Generic, TypeVar

from rclpy._rclpy_pybind11 import RCLError
from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

__all__ = ["IN_A_TURN", "NEVER", "Background", "Once", "PolledClock", "RCLError", "Waiting", "given_parameters",
           "hidden", "in_executor", "waiting"]  # fmt: skip

T = TypeVar("T")
IN_A_TURN = 100  # samples that are taken before anything else has its turn


def given_parameters(node: Node) -> Mapping[str, Parameter]:
    """Return the parameters that a node was given, declared or not: rclpy passes over a misspelt one."""
    found: Mapping[str, Parameter[Any]] = node._parameter_overrides  # nothing public tells
    return found


def hidden(action: str, part: str) -> str:
    """Return the name of a topic or service of an action: `status`, `feedback`, `send_goal`, `cancel_goal`."""
    return f"{action}/_action/{part}"


# --- streams ----------------------------------------------------------------------------------------------------------


def waiting(subscription: Any, most: int = IN_A_TURN) -> Iterator[tuple[Any, Mapping[str, Any]]]:
    """Take what waits in a subscription, message by message, in its order; nothing more once it was destroyed.

    Args:
        subscription: Of a node.
        most: Messages that are taken.

    Yields:
        A message, and what the middleware says of it.
    """
    for _ in range(most):
        try:
            with subscription.handle:
                one = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        except InvalidHandle:
            return
        if one is None:
            return
        yield one


class _Polled(CallbackGroup):
    """A group whose subscriptions never wake the executor."""

    def can_execute(self, _entity: Any) -> bool:
        """Nothing is ever due."""
        return False

    def beginning_execution(self, _entity: Any) -> bool:
        """Nothing ever begins."""
        return False

    def ending_execution(self, _entity: Any) -> None:
        """Nothing ever ends."""


NEVER = _Polled()  # the group of what never wakes the executor


class Waiting:
    """A subscription that never wakes the executor: what it holds is taken when somebody looks."""

    def __init__(self, node: Node, kind: Any, name: str, quality: QoSProfile, *, raw: bool = False) -> None:
        """Subscribe.

        Args:
            node: Who subscribes.
            kind: Class of the messages.
            name: Topic.
            quality: Profile; its depth is what can wait.
            raw: Whether messages stay bytes, as CDR.
        """
        more: dict[str, Any] = {"callback_group": NEVER, "raw": raw}
        self.subscription = node.create_subscription(kind, name, lambda _message: None, quality, **more)
        self._looked = time.monotonic()

    def take(self, most: int = IN_A_TURN) -> list[Any]:
        """Return what has come since the last look, in its order, at most so many messages."""
        return [message for message, _ in waiting(self.subscription, most)]

    def arrivals(self, most: int = IN_A_TURN) -> Iterator[tuple[Any, float, int | None]]:
        """Take what has come since the last look, in its order, at most so many messages.

        Yields:
            A message; when it arrived, s of the steady clock; the number that its publisher gave it, None where the
            middleware does not tell.  The middleware knows the arrival by the clock of the day, which may be set:
            beyond the last look and this one, it is not believed.
        """
        before, self._looked = self._looked, time.monotonic()
        to_steady = self._looked - time.time()
        for message, info in waiting(self.subscription, most):
            arrived = 1e-9 * info["received_timestamp"] + to_steady
            yield message, min(max(arrived, before), self._looked), info["publication_sequence_number"]


class PolledClock:
    """A simulation's `/clock`, looked at when somebody asks for the time: it would wake each node for every tick."""

    def __init__(self, subscription: Any) -> None:
        """Take the subscription of rclpy's own time source."""
        self._subscription, self._lock = subscription, threading.Lock()

    def look(self) -> None:
        """Hand what has come to the time source; from any thread."""
        with self._lock:
            for message, _ in waiting(self._subscription):
                self._subscription.callback(message)


# --- threads ----------------------------------------------------------------------------------------------------------


def in_executor(node: Node, work: Callable[[], object]) -> None:
    """Do something short in the thread that spins a node; at once where nobody spins it.

    An action client files a goal only after it was sent: an answer that another thread takes in between is lost.
    """
    executor = node.executor
    if executor is None:
        work()
    else:
        executor.create_task(work)


class Once:
    """Awaits that a condition comes true; the executor looks at every turn."""

    def __init__(self, condition: Callable[[], bool]) -> None:
        """Take the condition."""
        self._condition = condition

    def __await__(self) -> Generator[None, None, None]:
        """Give the executor back until it is true."""
        while not self._condition():
            yield


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
        yield from Once(self._done.is_set).__await__()
        if self._error is not None:
            raise self._error
        return self._result[0]
