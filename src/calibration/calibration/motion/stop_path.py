"""How somebody else than the sequencer stops a motion: the guard's side of each back end.

follow_joint_trajectory, simulated   every goal of the action is cancelled
joint_trajectory_topic               a trajectory of one point, where the robot is, takes the place of the motion
external                             nothing: only the hand on the pendant stops the robot
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_action_status_default
from trajectory_msgs.msg import JointTrajectory

from calibration.motion import follow_joint_trajectory, joint_trajectory_topic, simulated
from calibration.motion.base import Standing
from calibration.motion.messages import hold
from calibration_core.errors import InputError, quoted
from calibration_core.motion.stop_proof import RequestedStop

ANSWER = 1.0  # s, in which a driver acknowledges that it cancels
OVER = (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED)
Ended = Callable[[bytes, bool], None]
"""Called when a goal is over: its identifier, and whether it ended as cancelled."""


class StopPath(Protocol):
    """A way to stop the robot; methods return at once.

    Attributes:
        how: What the driver does.
        text: The same for a person, with names.
    """

    how: RequestedStop
    text: str

    def command(self, now: float) -> None:
        """Stop whatever is being followed; `now` is s of the steady clock."""

    @property
    def waiting(self) -> bool:
        """Whether the driver has yet to acknowledge a stop."""

    def unanswered(self, now: float) -> bool:
        """Tell whether a driver that has to acknowledge a stop has not done so in time."""


class CancelGoals:
    """Cancels every goal of an action."""

    how = RequestedStop.CANCEL

    def __init__(self, node: Node, action: str, ended: Ended) -> None:
        """Take the action's name, and who is told of goals that are over."""
        self.text = f"every goal of {action} is cancelled"
        self._client = node.create_client(CancelGoal, f"{action}/_action/cancel_goal")
        self._ended = ended
        self._since = math.inf  # of the oldest stop that is not acknowledged
        node.create_subscription(
            GoalStatusArray, f"{action}/_action/status", self._on_status, qos_profile_action_status_default
        )

    def command(self, now: float) -> None:
        """Cancel; without a goal's name and a time it means all goals."""
        self._since = now if self.unanswered(now) else min(self._since, now)
        self._client.call_async(CancelGoal.Request()).add_done_callback(self._on_answer)

    @property
    def waiting(self) -> bool:
        """Whether the driver has yet to acknowledge."""
        return math.isfinite(self._since)

    def unanswered(self, now: float) -> bool:
        """Tell whether the driver has not acknowledged in time."""
        return now - self._since > ANSWER

    def _on_answer(self, future: Any) -> None:
        if future.exception() is None:
            self._since = math.inf

    def _on_status(self, message: Any) -> None:
        for one in message.status_list:
            if one.status in OVER:
                self._ended(bytes(one.goal_info.goal_id.uuid), one.status == GoalStatus.STATUS_CANCELED)


class HoldPosition:
    """Sends the robot where it is."""

    how = RequestedStop.HOLD
    waiting = False

    def __init__(self, node: Node, topic: str, joints: tuple[str, ...], where: Standing) -> None:
        """Take the topic's name, the joints in the order of q, and what tells where the robot is."""
        self.text = f"the position is held by {topic}"
        self._joints, self._where = joints, where
        self._publisher = node.create_publisher(JointTrajectory, topic, QoSProfile(depth=10))

    def command(self, now: float) -> None:  # noqa: ARG002  # nothing is answered
        """Hold; nothing where the position is not known."""
        where = self._where()
        if where is not None:
            self._publisher.publish(hold(self._joints, where))

    def unanswered(self, now: float) -> bool:  # noqa: ARG002
        """Nothing is ever answered."""
        return False


class Pendant:
    """Somebody else moves the robot: nothing is commanded, and nothing can be stopped."""

    how = RequestedStop.NONE
    waiting = False
    text = f"none: {RequestedStop.NONE.value}"

    def command(self, now: float) -> None:
        """Do nothing."""

    def unanswered(self, now: float) -> bool:  # noqa: ARG002
        """Nothing is ever answered."""
        return False


def make_stop_path(
    name: str, node: Any, joints: tuple[str, ...], *, interface: str, where: Standing, ended: Ended
) -> StopPath:
    """Return the stop path of a back end; `ended` is told of goals that are over, the rest as for `make_backend`.

    Raises:
        InputError: There is no such back end.
    """
    match name:
        case "follow_joint_trajectory":
            return CancelGoals(node, interface or follow_joint_trajectory.DEFAULT, ended)
        case "simulated":
            return CancelGoals(node, interface or simulated.DEFAULT, ended)
        case "joint_trajectory_topic":
            return HoldPosition(node, interface or joint_trajectory_topic.DEFAULT, joints, where)
        case "external":
            return Pendant()
    raise InputError("parameters", "motion.backend", quoted(name), "one of the back ends")
