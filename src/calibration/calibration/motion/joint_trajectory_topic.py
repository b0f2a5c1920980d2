"""A controller's topic: trajectories are published and nothing is answered, so that arrival is judged by joint states.

An empty trajectory would leave some controllers running on; what stops all of them is one point where the robot is.
"""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from calibration.motion.base import Done, Standing
from calibration.motion.messages import hold, to_joint_trajectory
from calibration_core.motion.trajectory import Trajectory

DEFAULT = "joint_trajectory_controller/joint_trajectory"
POLL = 0.05  # s


class TopicMotion:
    """The back end."""

    def __init__(self, node: Node, joints: tuple[str, ...], where: Standing, name: str = "") -> None:
        """Open the topic.

        Args:
            node: Who publishes.
            joints: Names, in the order of q.
            where: Tells where the robot is.
            name: Of the topic.
        """
        self._name = name or DEFAULT
        self._joints, self._where = joints, where
        self._publisher = node.create_publisher(JointTrajectory, self._name, QoSProfile(depth=10))
        self._moving = False

    @property
    def answers(self) -> bool:
        """Nobody says when a motion has ended."""
        return False

    @property
    def goal(self) -> bytes | None:
        """There are no goals."""
        return bytes(16)

    @property
    def commands(self) -> bool:
        """The robot moves by our command."""
        return True

    def prepare(self, timeout: float) -> str:
        """Wait for somebody who listens."""
        end = time.monotonic() + timeout
        while not self._publisher.get_subscription_count():
            if time.monotonic() > end:
                return f"nobody listens to {self._name}"
            time.sleep(POLL)
        return ""

    def move(self, trajectory: Trajectory, done: Done) -> None:  # noqa: ARG002  # nothing is ever answered
        """Publish it."""
        self._moving = True
        self._publisher.publish(to_joint_trajectory(trajectory))

    def stop(self) -> None:
        """Hold where the robot is."""
        where = self._where()
        if self._moving and where is not None:
            self._moving = False
            self._publisher.publish(hold(self._joints, where))

    def tick(self, now: float) -> None:
        """Nothing is awaited."""
