"""Actions of other nodes that the procedure needs: averages of the instruments, loads of a load device.

Every request is answered exactly once, by words of its own if the server does not answer.
"""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from calibration_interfaces.action import ApplyLoad, Measure
from calibration_interfaces.msg import Outcome
from rclpy.action import ActionClient
from rclpy.node import Node

from calibration.conversions import Mean, from_average, to_stamp, to_wrench
from calibration.rclpy_gaps import in_executor
from calibration_core.timeseries import Float1D

Answered = Callable[[Any, str], None]
"""Called once: the action's result, or None and why there is none."""
ACCEPT_TIME = 5.0  # s of wall time, to accept a goal


@dataclasses.dataclass(eq=False)
class _Request:
    answered: Answered
    deadline: float
    handle: Any = None
    over: bool = False


class ActionPort:
    """An action client that never leaves a request unanswered."""

    def __init__(self, node: Node, action: Any, name: str) -> None:
        """Listen for the action."""
        self.name, self._node = name, node
        self._client = ActionClient(node, action, name)
        self._lock = threading.Lock()
        self._requests: list[_Request] = []

    def missing(self) -> str:
        """Say that there is no server; empty if there is one."""
        return "" if self._client.server_is_ready() else f"no action server {self.name}"

    def ask(self, goal: Any, answered: Answered, wait: float, feedback: Callable[[Any], None] | None = None) -> None:
        """Send a goal.

        Args:
            goal: Of the action.
            answered: Called once.
            wait: s of wall time, that the result may take once the goal is accepted.
            feedback: Called with each feedback, in the executor's thread.
        """
        request = _Request(answered, time.monotonic() + ACCEPT_TIME)
        with self._lock:
            self._requests.append(request)

        def send() -> None:
            future = self._client.send_goal_async(goal, feedback_callback=feedback)
            future.add_done_callback(lambda accepted: self._on_accept(request, accepted, wait))

        in_executor(self._node, send)

    def cancel(self) -> None:
        """Give up whatever is under way; what is not accepted yet is cancelled as soon as it is."""
        self._give_up(math.inf, "it is not wanted any more")

    def tick(self, now: float) -> None:
        """Give up requests whose answer does not come; `now` is s of the steady clock."""
        self._give_up(now, f"{self.name} does not answer")

    def _give_up(self, now: float, why: str) -> None:
        with self._lock:
            late = [request for request in self._requests if now > request.deadline]
        for request in late:
            if request.handle is not None:
                in_executor(self._node, request.handle.cancel_goal_async)
            self._end(request, None, why)

    def _on_accept(self, request: _Request, future: Any, wait: float) -> None:
        handle = future.result() if future.exception() is None else None
        if handle is None or not handle.accepted:
            self._end(request, None, f"{self.name} rejects the request")
            return
        if request.over:
            handle.cancel_goal_async()
            return
        with self._lock:
            request.handle, request.deadline = handle, time.monotonic() + wait
        handle.get_result_async().add_done_callback(lambda answer: self._on_result(request, answer))

    def _on_result(self, request: _Request, future: Any) -> None:
        error = future.exception()
        self._end(request, None if error else future.result().result, str(error or ""))

    def _end(self, request: _Request, result: Any, text: str) -> None:
        with self._lock:
            if request.over:
                return
            request.over = True
            self._requests.remove(request)
        request.answered(result, text)


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """What the instruments answered; `fault` is empty if all of them did."""

    points: tuple[Mean, ...] = ()
    wrench: Mean | None = None
    fault: str = ""


class Instruments:
    """Tracker and, where there is one, force/torque sensor, asked together."""

    def __init__(self, node: Node, tracker: str, force_torque: str) -> None:
        """Take the names of the actions; an empty one is an instrument that the cell does not have."""
        self.ports = {"tracker": ActionPort(node, Measure, tracker)}
        if force_torque:
            self.ports["force_torque"] = ActionPort(node, Measure, force_torque)
        self._shares: dict[str, float] = {}  # of their windows, while an average is being taken

    @property
    def averaged(self) -> float:
        """Share of the averaging window, 0 to 1, of the instrument that is least far; NaN: nothing is averaged."""
        return min(list(self._shares.values()), default=math.nan)

    def measure(
        self, points: Sequence[str], window: float, timeout: float, samples: int, since: int, wait: float,
        answered: Callable[[Measured], None],
    ) -> None:  # fmt: skip
        """Average over one window.

        Args:
            points: Measurement points.
            window: s.
            timeout: s, longest wait for a settled window, by the instruments' clock.
            samples: Least number, per stream; 0: the node's own.
            since: ns, stamp before which no sample counts: an instrument's node may lag behind the joint states.
            wait: s of wall time, longest wait for the answer.
            answered: Called once with the averages.
        """
        lock, results = threading.Lock(), dict[str, Any]()
        shares = self._shares = dict.fromkeys(self.ports, 0.0)

        def on_answer(instrument: str) -> Answered:
            def take(result: Any, text: str) -> None:
                with lock:
                    results[instrument] = (result, text)
                    shares[instrument] = 1.0
                    complete = len(results) == len(self.ports)
                if complete:
                    shares.clear()
                    answered(_together(results))

            return take

        def on_feedback(instrument: str) -> Callable[[Any], None]:
            def take(message: Any) -> None:
                with lock:
                    if instrument not in results:
                        shares[instrument] = float(message.feedback.share_done)

            return take

        for instrument, port in self.ports.items():
            names = list(points) if instrument == "tracker" else []
            goal = Measure.Goal(names=names, window=window, timeout=timeout, min_samples=samples, since=to_stamp(since))
            port.ask(goal, on_answer(instrument), wait, on_feedback(instrument))

    def cancel(self) -> None:
        """Give up what is being measured."""
        for port in self.ports.values():
            port.cancel()

    def tick(self, now: float) -> None:
        """Give up instruments that do not answer."""
        for port in self.ports.values():
            port.tick(now)


def _together(results: dict[str, Any]) -> Measured:
    faults = []
    for instrument, (result, text) in results.items():
        if result is None:
            faults.append(text)
        elif result.outcome.code != Outcome.OK:
            faults.append(f"{instrument}: {result.outcome.text}")
    if faults:
        return Measured(fault="; ".join(faults))
    points = tuple(from_average(average) for average in results["tracker"][0].averages)
    wrench = results.get("force_torque")
    return Measured(points, None if wrench is None else from_average(wrench[0].averages[0]))


class LoadDevice:
    """A load device with the action `ApplyLoad`."""

    def __init__(self, node: Node, name: str) -> None:
        """Take the action's name."""
        self.port = ActionPort(node, ApplyLoad, name)

    def apply(self, wrench: Float1D, timeout: float, wait: float, answered: Callable[[bool, str], None]) -> None:
        """Ask for a wrench (6,) N and N*m, base axes, at the wrench point; timeouts as for `Instruments.measure`."""

        def take(result: Any, text: str) -> None:
            if result is None:
                answered(False, text)
            else:
                answered(result.outcome.code == Outcome.OK, str(result.outcome.text))

        self.port.ask(ApplyLoad.Goal(target=to_wrench(wrench), timeout=timeout), take, wait)
