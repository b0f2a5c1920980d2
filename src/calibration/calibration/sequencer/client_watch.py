"""Whether anybody still takes the feedback of a run: whose client is gone, nobody minds the robot for.

A client that ends well leaves the graph at once; one that was killed stands in it for 20 s.
"""

from __future__ import annotations

from rclpy.node import Node

GRACE = 5.0  # s, that a client may take to be found in the graph


class ClientWatch:
    """Looks for subscribers of an action's feedback; times are s of the steady clock."""

    def __init__(self, node: Node, action: str) -> None:
        """Take the action's name."""
        self._node, self._topic = node, node.resolve_topic_name(f"{action}/_action/feedback")
        self._there, self._deadline = False, 0.0

    def begin(self, now: float) -> None:
        """Expect a client from now on."""
        self._there, self._deadline = True, now + GRACE

    def vanished(self, now: float) -> bool:
        """Tell, once, that the last client has gone; one that comes later is minded anew."""
        listening = self._node.count_subscribers(self._topic) > 0
        if listening:
            self._deadline = min(self._deadline, now)
        if listening == self._there or now < self._deadline:
            return False
        self._there = listening
        return not listening
