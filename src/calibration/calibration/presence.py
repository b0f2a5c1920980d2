"""One owner: a second node of a kind in the same namespace is refused by the first one's presence.

Each says several times a second that it is there, with a number of its own.  Whoever starts listens first, and does not
begin where it hears another of its kind.  Two that start at the same moment hear each other later: the younger one
ends, and the elder one stops what it does.  The graph would not do: a process that was killed stands in it for 20 s.
"""

from __future__ import annotations

import os
import secrets
import socket
import time
from collections.abc import Callable
from typing import Any

import rclpy
from calibration_interfaces.msg import Presence as PresenceMessage
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from calibration_core.errors import InputError

TOPIC = "calibration/presence"
PERIOD = 0.1  # s, between two signs
LISTEN = 0.8  # s of wall time, for another one before the start
FOUND = 0.5  # s, likewise, from when another one is found in the graph: its sign is on its way, or it is dead
QOS = QoSProfile(depth=10)

Second = Callable[[str, bool], None]
"""Called for every sign of another of the kind: words about it, and whether we are the younger one."""


class Presence:
    """Says that a node is there, and hears others of its kind.

    Attributes:
        identifier: Of the node, drawn at its start.
    """

    def __init__(self, node: Node, role: str, on_second: Second) -> None:
        """Begin.

        Args:
            node: The node.
            role: What it is.
            on_second: Called when another one is heard.
        """
        self._role, self._on_second = role, on_second
        self.identifier = secrets.randbits(63)
        self._own = PresenceMessage(
            role=role,
            identifier=self.identifier,
            since=time.time_ns(),
            process=os.getpid(),
            computer=socket.gethostname(),
        )
        publisher = node.create_publisher(PresenceMessage, TOPIC, QOS)
        node.create_subscription(PresenceMessage, TOPIC, self._on_presence, QOS)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, lambda: publisher.publish(self._own), clock=steady)

    def _on_presence(self, message: Any) -> None:
        if message.role == self._role and message.identifier != self.identifier:
            own, other = self._own, message
            younger = (own.since, own.identifier) > (other.since, other.identifier)
            self._on_second(words(message), younger)


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
        PresenceMessage, TOPIC, lambda message: heard.append(message) if message.role == role else None, QOS
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
