"""Back ends by name."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from calibration.motion.arrival import ArrivalRules
from calibration.motion.base import Backend, Course
from calibration.motion.external import ExternalMotion
from calibration.motion.follow_joint_trajectory import follow_joint_trajectory
from calibration.motion.joint_trajectory_topic import TopicMotion
from calibration.motion.simulated import simulated
from calibration.node import Declared
from calibration.process_tree import BACKENDS
from calibration_core.errors import InputError, quoted

MOTION_INTERFACE = (
    Declared("motion.backend", BACKENDS[0], "How the robot is moved, and stopped.", choices=BACKENDS),
    Declared("motion.interface", "", "Name of the action or topic; empty: the back end's usual one."),
)
"""Parameters that whoever moves the robot and whoever stops it have in common."""
GOAL_TIME = 10.0  # s, that a driver may take beyond a trajectory's end


def make_backend(
    name: str,
    node: Node,
    joints: tuple[str, ...],
    *,
    interface: str,
    rules: ArrivalRules,
    course: Course,
    ask: Callable[[str], None],
) -> Backend:
    """Return a back end.

    Args:
        name: One of `BACKENDS`.
        node: Whose executor carries the answers.
        joints: Names, in the order of q.
        interface: Name of the action or topic; empty: the usual one.
        rules: When the robot has arrived.
        course: Tells where the robot is, and how it moves.
        ask: Shows a text to the operator.

    Raises:
        InputError: There is no such back end, or its message package is not installed.
    """
    match name:
        case "follow_joint_trajectory":
            return follow_joint_trajectory(node, interface, tolerance=rules.tolerance, goal_time=GOAL_TIME)
        case "joint_trajectory_topic":
            return TopicMotion(node, joints, course, interface)
        case "external":
            return ExternalMotion(ask)
        case "simulated":
            return simulated(node, interface)
    raise InputError("parameters", "motion.backend", quoted(name), f"one of {', '.join(BACKENDS)}")
