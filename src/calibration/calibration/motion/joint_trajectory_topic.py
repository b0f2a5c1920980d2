"""A controller's topic: trajectories are published and nothing is answered, so that arrival is judged by joint states.

An empty trajectory would leave some controllers running on; what stops all of them is one point at rest.
"""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from calibration.motion.base import Course, Done
from calibration.motion.messages import hold, to_joint_trajectory
from calibration_core.motion.trajectory import Trajectory

DEFAULT = "joint_trajectory_controller/joint_trajectory"


class TopicMotion:
    """The back end."""

    def __init__(self, node: Node, joints: tuple[str, ...], course: Course, name: str = "") -> None:
        """Open the topic.

        Args:
            node: Who publishes.
            joints: Names, in the order of q.
            course: Tells where the robot is, and how it moves.
            name: Of the topic.
        """
        self._name = name or DEFAULT
        self._joints, self._course = joints, course
        self._publisher = node.create_publisher(JointTrajectory, self._name, QoSProfile(depth=10))
        self._commanded = False

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

    def missing(self) -> str:
        """Look for somebody who listens."""
        return "" if self._publisher.get_subscription_count() else f"nobody listens to {self._name}"

    def move(self, trajectory: Trajectory, done: Done) -> None:  # noqa: ARG002  # nothing is ever answered
        """Publish it."""
        self._commanded = True
        self._publisher.publish(to_joint_trajectory(trajectory))

    def stop(self) -> None:
        """Bring the robot to rest on its way, as often as that is said: nobody tells when a motion has ended."""
        course = self._course()
        if self._commanded and course is not None:
            self._publisher.publish(hold(self._joints, *course))

    def tick(self, now: float) -> None:
        """Nothing is awaited."""
