"""The simulated cell's own action, `MoveTo`; any driver may offer it."""

from __future__ import annotations

from typing import Any

from calibration_interfaces.action import MoveTo
from calibration_interfaces.msg import Outcome
from rclpy.node import Node

from calibration.motion.action_motion import ActionMotion
from calibration.motion.messages import to_joint_trajectory

DEFAULT = "driver/move_to"


def verdict(answer: Any) -> tuple[bool, str]:
    """Read the outcome."""
    outcome = answer.result.outcome
    return outcome.code == Outcome.OK, str(outcome.text)


def simulated(node: Node, name: str = "") -> ActionMotion:
    """Return the back end."""
    return ActionMotion(
        node,
        MoveTo,
        name or DEFAULT,
        lambda trajectory: MoveTo.Goal(trajectory=to_joint_trajectory(trajectory)),
        verdict,
    )
