"""`control_msgs/action/FollowJointTrajectory`, which the ros2_control drivers and MotoROS2 offer.

The message package is imported when this back end is chosen.
"""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from calibration.motion.action_motion import ActionMotion
from calibration.motion.messages import to_duration, to_joint_trajectory
from calibration.topics import load_type
from calibration_core.motion.trajectory import Trajectory

DEFAULT = "joint_trajectory_controller/follow_joint_trajectory"
ACTION = "control_msgs/action/FollowJointTrajectory"
SUCCEEDED = 4  # action_msgs/GoalStatus
ERRORS = {
    -1: "invalid goal",
    -2: "invalid joints",
    -3: "old header timestamp",
    -4: "path tolerance violated",
    -5: "goal tolerance violated",
}


def verdict(answer: Any) -> tuple[bool, str]:
    """Read the error code; whatever is not zero is a failure, whoever made it."""
    code, text = int(answer.result.error_code), str(answer.result.error_string)
    return code == 0 and answer.status == SUCCEEDED, "; ".join(filter(None, [decoded(code), text]))


def decoded(code: int) -> str:
    """Say an error code.  MotoROS2 packs its own code in front of the standard one: -ECCCCC."""
    if code in ERRORS or code == 0:
        return ERRORS.get(code, "")
    standard = -(abs(code) // 100_000)
    if standard in ERRORS:
        return f"{ERRORS[standard]}, driver's code {abs(code) % 100_000}"
    return f"error code {code}"


def to_goal(action: Any, tolerance_type: Any, trajectory: Trajectory, tolerance: float, goal_time: float) -> Any:
    """Return the goal that every driver accepts.

    Args:
        action: The action's class.
        tolerance_type: `control_msgs/msg/JointTolerance`.
        trajectory: What to follow.
        tolerance: rad, of every joint at the goal.
        goal_time: s, beyond the trajectory's end that the driver may take.
    """
    goal = action.Goal(trajectory=to_joint_trajectory(trajectory))
    goal.goal_tolerance = [tolerance_type(name=joint, position=tolerance) for joint in trajectory.joints]
    goal.goal_time_tolerance = to_duration(goal_time)
    return goal


def follow_joint_trajectory(node: Node, name: str = "", *, tolerance: float, goal_time: float) -> ActionMotion:
    """Return the back end.

    Raises:
        InputError: `control_msgs` is not installed; the text says what installs it.
    """
    action, tolerance_type = load_type(ACTION), load_type("control_msgs/msg/JointTolerance")
    return ActionMotion(
        node,
        action,
        name or DEFAULT,
        lambda trajectory: to_goal(action, tolerance_type, trajectory, tolerance, goal_time),
        verdict,
    )
