"""`manager`: notices a node that falls silent, and tells the state of the cell.

It moves nothing, permits nothing, ends no node because another one has ended, and starts none: that is the launch's.
`calibration/state` is everything that a panel needs, in one message.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from calibration_interfaces.msg import Conditions, NodeHealth
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile

from calibration.conversions import to_header
from calibration.node import QOS, TOPIC, CalibrationNode, Declared, run
from calibration.status import MISSED, Whole
from calibration.topics import (
    CONDITIONS_QUALITY,
    PERMISSION,
    PROCEDURE,
    PROGRESS,
    READING,
    ROBOT_STATE,
    SAMPLE_CHECK,
    STATE,
    profile,
)
from calibration_core.cell import load_cell

NAMES = ("guard", "recorder", "tracker", "force_torque", "identification", "sequencer", "compensation")
LOOK = 0.1  # s of wall time between two looks, and at least between two messages
PERIOD = 0.2  # s of wall time between two messages that tell nothing new: who reads them sees at once that none comes

PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("nodes", list(NAMES), "Nodes that are watched."),
    Declared("permission_age", 0.5, "s, that the guard's last word is shown.", low=0.02, high=10.0),
)


class ManagerNode(CalibrationNode):
    """Watches and tells."""

    def __init__(self, **kwargs: Any) -> None:
        """Make the node.

        Raises:
            InputError: A parameter or the cell file cannot be used.
        """
        super().__init__("manager", PARAMETERS, **kwargs)

    def on_start(self) -> None:
        """Listen to every node, and to what they say of the cell."""
        cell = load_cell(self.value("cell"), live=True)
        self.whole = Whole(tuple(self.value("nodes")), self.value("permission_age"))
        self._reported: dict[str, object] = {}
        self._sent = -math.inf
        self._publisher = self.create_publisher(STATE.message, STATE.relative, STATE.qos)
        self.create_subscription(NodeHealth, TOPIC, self._on_health, QOS)
        for topic, field in (
            (PROCEDURE, "procedure"),
            (PERMISSION, "permission"),
            (ROBOT_STATE, "robot"),
            (PROGRESS, "progress"),
        ):
            self.create_subscription(topic.message, topic.relative, partial(self._on_part, field), topic.qos)
        conditions = cell.topics.conditions.lstrip("/")
        self.create_subscription(
            Conditions, conditions, partial(self._on_part, "conditions"), profile(CONDITIONS_QUALITY)
        )
        self.create_subscription(SAMPLE_CHECK.message, SAMPLE_CHECK.relative, self.whole.hear_stream, SAMPLE_CHECK.qos)
        now = QoSProfile(depth=100)  # what was said before belongs to no run under way
        self.create_subscription(READING.message, READING.relative, self._on_reading, now)
        self.create_timer(LOOK, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # --- what is heard -----------------------------------------------------------------------------------------------

    def _on_part(self, field: str, message: Any) -> None:
        self.whole.hear(field, message, time.monotonic())

    def _on_reading(self, message: Any) -> None:
        self.whole.hear_reading(message, time.monotonic())

    def _on_health(self, message: NodeHealth) -> None:
        if self.whole.hear_node(message, time.monotonic()):
            self.get_logger().info(f"{message.name} is heard: process {message.process} on {message.computer}")

    def _look(self) -> None:
        now = time.monotonic()
        for name in self.whole.silent(now):
            self.get_logger().error(f"{name} is silent: {MISSED.get(name, 'it does not work')}")
        self._report(now)

    def _report(self, now: float) -> None:
        """Send the state if it is news, and once a period."""
        message = self.whole.message(now)
        news = self.whole.news(message)
        if news == self._reported and now - self._sent < PERIOD:
            return
        self._reported, self._sent = news, now
        message.header = to_header(self.now_ns())
        self._publisher.publish(message)
        gravest = max((int(one.level) for one in message.faults), default=0)
        self.diagnostics.report("cell", gravest, "; ".join(str(one.text) for one in message.faults) or "all is well")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(ManagerNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
