"""How somebody else than the sequencer stops a motion: the guard's side of each back end.

follow_joint_trajectory, simulated   every goal of the action is cancelled
joint_trajectory_topic               a trajectory of one point, where the robot is, takes the place of the motion
external                             nothing: only the hand on the pendant stops the robot
"""

from __future__ import annotations

from typing import Any, Protocol

from action_msgs.srv import CancelGoal
from rclpy.node import Node
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from calibration.motion import follow_joint_trajectory, joint_trajectory_topic, simulated
from calibration.motion.base import Standing
from calibration.motion.messages import hold
from calibration_core.errors import InputError, quoted

PENDANT = "none: only the hand on the pendant stops the robot"


class StopPath(Protocol):
    """A way to stop the robot; methods return at once."""

    @property
    def exists(self) -> bool:
        """Whether there is one."""

    @property
    def text(self) -> str:
        """What it does, for a person."""

    def command(self) -> None:
        """Stop whatever is being followed."""


class CancelGoals:
    """Cancels every goal of an action."""

    exists = True

    def __init__(self, node: Node, action: str) -> None:
        """Take the action's name."""
        self.text = f"every goal of {action} is cancelled"
        self._client = node.create_client(CancelGoal, f"{action}/_action/cancel_goal")

    def command(self) -> None:
        """Cancel; without a goal's name and a time it means all goals."""
        self._client.call_async(CancelGoal.Request())


class HoldPosition:
    """Sends the robot where it is."""

    exists = True

    def __init__(self, node: Node, topic: str, joints: tuple[str, ...], where: Standing) -> None:
        """Take the topic's name, the joints in the order of q, and what tells where the robot is."""
        self.text = f"the position is held by {topic}"
        self._joints, self._where = joints, where
        self._publisher = node.create_publisher(JointTrajectory, topic, QoSProfile(depth=10))

    def command(self) -> None:
        """Hold; nothing where the position is not known."""
        where = self._where()
        if where is not None:
            self._publisher.publish(hold(self._joints, where))


class Pendant:
    """Somebody else moves the robot: nothing is commanded, and nothing can be stopped."""

    exists = False
    text = PENDANT

    def command(self) -> None:
        """Do nothing."""


def make_stop_path(name: str, node: Any, joints: tuple[str, ...], *, interface: str, where: Standing) -> StopPath:
    """Return the stop path of a back end; arguments as for `make_backend`.

    Raises:
        InputError: There is no such back end.
    """
    match name:
        case "follow_joint_trajectory":
            return CancelGoals(node, interface or follow_joint_trajectory.DEFAULT)
        case "simulated":
            return CancelGoals(node, interface or simulated.DEFAULT)
        case "joint_trajectory_topic":
            return HoldPosition(node, interface or joint_trajectory_topic.DEFAULT, joints, where)
        case "external":
            return Pendant()
    raise InputError("parameters", "motion.backend", quoted(name), "one of the back ends")
