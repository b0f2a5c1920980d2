"""Actions of other nodes that the procedure needs: averages of the instruments, loads of a load device.

Every request is answered exactly once, by words of its own if the server does not answer.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from calibration_interfaces.action import Measure
from calibration_interfaces.msg import Outcome
from rclpy.node import Node

from calibration.asks import Ended, Server
from calibration.conversions import Mean, from_average, to_stamp


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """What the instruments answered; `fault` is empty if all of them did.

    In `excluded` stand the points that an operator has left out meanwhile, with by whom and why.
    """

    points: tuple[Mean, ...] = ()
    wrench: Mean | None = None
    fault: str = ""
    excluded: Mapping[str, str] = dataclasses.field(default_factory=dict)


class Instruments:
    """Tracker and, where there is one, force/torque sensor, asked together."""

    def __init__(self, node: Node, tracker: str, force_torque: str) -> None:
        """Take the names of the actions; an empty one is an instrument that the cell does not have."""
        self.servers = {"tracker": Server(node, Measure, tracker)}
        if force_torque:
            self.servers["force_torque"] = Server(node, Measure, force_torque)
        self._shares: dict[str, float] = {}  # of their windows, while an average is being taken
        self.under_way = Measure.Feedback()  # the tracker's last one while it measures

    @property
    def averaged(self) -> float:
        """Share of the averaging window, 0 to 1, of the instrument that is least far; NaN: nothing is averaged."""
        return min(list(self._shares.values()), default=math.nan)

    def measure(
        self, points: Sequence[str], window: float, timeout: float, since: int, wait: float,
        answered: Callable[[Measured], None],
    ) -> None:  # fmt: skip
        """Average over one window.

        Args:
            points: Measurement points.
            window: s.
            timeout: s, longest wait for a settled window, by the instruments' clock.
            since: ns, stamp before which no sample counts: an instrument's node may lag behind the joint states.
            wait: s of wall time, longest wait for the answer.
            answered: Called once with the averages.
        """
        lock, results = threading.Lock(), dict[str, Any]()
        shares = self._shares = dict.fromkeys(self.servers, 0.0)

        def on_answer(instrument: str) -> Ended:
            def take(answer: Any, text: str) -> None:
                with lock:
                    results[instrument] = (None if answer is None else answer.result, text)
                    shares[instrument] = 1.0
                    if instrument == "tracker":
                        self.under_way = Measure.Feedback()
                    complete = len(results) == len(self.servers)
                if complete:
                    shares.clear()
                    answered(_together(results))

            return take

        def on_feedback(instrument: str) -> Callable[[Any], None]:
            def take(message: Any) -> None:
                with lock:
                    if instrument not in results:
                        shares[instrument] = float(message.feedback.share_done)
                        if instrument == "tracker":
                            self.under_way = message.feedback

            return take

        for instrument, server in self.servers.items():
            names = list(points) if instrument == "tracker" else []
            goal = Measure.Goal(names=names, window=window, timeout=timeout, since=to_stamp(since))
            server.ask(goal, on_answer(instrument), wait, feedback=on_feedback(instrument))


def _together(results: dict[str, Any]) -> Measured:
    faults = []
    for instrument, (result, text) in results.items():
        if result is None:
            faults.append(text)
        elif result.outcome.code != Outcome.OK:
            faults.append(f"{instrument}: {result.outcome.text}")
    tracker = results["tracker"][0]
    excluded = {} if tracker is None else dict(zip(tracker.excluded, tracker.exclusions, strict=True))
    if faults:
        return Measured(fault="; ".join(faults), excluded=excluded)
    points = tuple(from_average(average) for average in tracker.averages)
    wrench = results.get("force_torque")
    return Measured(points, None if wrench is None else from_average(wrench[0].averages[0]), excluded=excluded)
