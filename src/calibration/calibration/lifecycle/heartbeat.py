"""A sign of life, with the health: asserted by hand, so that a hung executor is as silent as a dead process."""

from __future__ import annotations

import os
import time
from typing import Any

from calibration_interfaces.msg import NodeHealth
from lifecycle_msgs.msg import State
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from calibration.conversions import to_stamp
from calibration.lifecycle import machine
from calibration_core.timeseries import NANOSECONDS

TOPIC = "heartbeat"  # below the node's name
PERIOD = 0.25  # s of wall time between two signs of life
FRESH = 0.7  # s of wall time without one, after which what the node has said is not shown as current any more
LEASE = 1.5  # s of wall time without one, after which the node counts as silent


def quality() -> QoSProfile:
    """Return how signs of life are carried: the last one counts, and its writer must assert that it lives."""
    return QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(nanoseconds=round(LEASE * NANOSECONDS)),
    )


class Heartbeat:
    """Sends a node's health again and again, and at once when it changes."""

    def __init__(self, node: Any) -> None:
        """Begin.

        Args:
            node: A `CalibrationNode`: its state, its last trouble and its diagnostics are what is sent.
        """
        self._node = node
        self._publisher = node.create_publisher(NodeHealth, f"~/{TOPIC}", quality())
        node.create_timer(PERIOD, self.beat, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def beat(self) -> None:
        """Send the health as it is now."""
        node = self._node
        level, text = node.diagnostics.worst
        remedy = ""
        if not node.active:
            level = NodeHealth.ERROR if node.trouble else NodeHealth.WARN
            text = node.trouble or machine.LABELS[node.state]
            asked = {machine.UNCONFIGURED: "configure", machine.INACTIVE: "activate"}.get(node.state, "")
            remedy = f"ros2 lifecycle set {node.get_fully_qualified_name()} {asked}" if asked else ""
        state = State(id=node.state, label=machine.LABELS[node.state])
        self._publisher.publish(
            NodeHealth(
                stamp=to_stamp(time.time_ns()), name=node.get_name(), process=os.getpid(), lifecycle=state,
                level=level, text=text, remedy=remedy,
            )
        )  # fmt: skip
