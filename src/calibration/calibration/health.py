"""A node's sign of life: how it stands, and who it is.

The executor sends it, so that a node that hangs is as silent as a dead process.  Of some kinds there may be but one in
a namespace.  Whoever starts listens first, and does not begin where it hears another of its kind.  Two that start at
the same moment hear each other later: the younger one ends, and the elder one stops what it does.  The graph would not
do: a process that was killed stands in it for 20 s.
"""

from __future__ import annotations

import os
import secrets
import socket
import time
from typing import Any

import rclpy
from calibration_interfaces.msg import NodeHealth
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from calibration.conversions import to_stamp
from calibration_core.errors import InputError

TOPIC = "calibration/health"  # of all nodes in a namespace
PERIOD = 0.25  # s of wall time between two signs of life
FRESH = 0.7  # s of wall time without one, after which what the node has said is not shown as current any more
LEASE = 1.5  # s of wall time without one, after which the node counts as silent
LISTEN = 0.8  # s of wall time, for another one before the start
FOUND = 0.5  # s, likewise, from when another one is found in the graph: its sign is on its way, or it is dead
QOS = QoSProfile(depth=50)  # every node of a cell, several times


class Health:
    """Sends a node's health again and again, and at once when it changes.

    Attributes:
        identifier: Of this node in this process, drawn at its start.
    """

    def __init__(self, node: Any, role: str) -> None:
        """Begin.

        Args:
            node: A `CalibrationNode`: the gravest of its diagnostics is what is sent.
            role: What it is.
        """
        self._node = node
        self.identifier = secrets.randbits(63)
        self._own = NodeHealth(
            role=role, name=node.get_name(), process=os.getpid(), computer=socket.gethostname(),
            identifier=self.identifier, since=time.time_ns(),
        )  # fmt: skip
        self._publisher = node.create_publisher(NodeHealth, TOPIC, QOS)
        if node.OWNER:
            node.create_subscription(NodeHealth, TOPIC, self._on_health, QOS)
        node.create_timer(PERIOD, self.send, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def send(self) -> None:
        """Send the health as it is now."""
        self._own.level, self._own.text = self._node.diagnostics.worst
        self._own.stamp = to_stamp(time.time_ns())
        self._publisher.publish(self._own)

    def _on_health(self, message: Any) -> None:
        if message.role == self._own.role and message.identifier != self.identifier:
            own, other = self._own, message
            younger = (own.since, own.identifier) > (other.since, other.identifier)
            self._node.on_second(words(message), younger)


def words(message: Any) -> str:
    """Say who else is there."""
    return f"two {message.role}s: another one is process {message.process} on {message.computer}"


def refuse_second(role: str, listen: float = LISTEN) -> None:
    """Listen for another node of a kind, before this one begins.

    Raises:
        InputError: There is one.
    """
    quiet = [Parameter("start_type_description_service", value=False)]  # it may do no more than the node to come
    node = rclpy.create_node(f"{role}_looks_around", start_parameter_services=False, parameter_overrides=quiet)
    heard: list[Any] = []
    node.create_subscription(
        NodeHealth, TOPIC, lambda message: heard.append(message) if message.role == role else None, QOS
    )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end, found = time.monotonic() + listen, False
    try:
        while not heard and (left := end - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=min(left, PERIOD))
            if not found and any(one.node_name == role for one in node.get_publishers_info_by_topic(TOPIC)):
                found, end = True, max(end, time.monotonic() + FOUND)
        if heard:
            raise InputError(role, f"namespace {node.get_namespace()}", words(heard[0]), "one")
    finally:
        executor.shutdown()
        node.destroy_node()
