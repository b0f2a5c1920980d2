"""The robot is moved by somebody else (a pendant program, hold-to-run): we ask, and see from joint states that it came.

This is how to measure where a driver moves the robot in automatic mode alone.  Nothing is commanded, so nothing can be
stopped either: only the hand on the pendant stops the robot.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calibration.motion.base import Done
from calibration_core.motion.trajectory import Trajectory


class ExternalMotion:
    """The back end."""

    def __init__(self, ask: Callable[[str], None]) -> None:
        """Take a function that shows a text to the operator."""
        self._ask = ask

    @property
    def answers(self) -> bool:
        """Nobody says when a motion has ended."""
        return False

    @property
    def goal(self) -> bytes | None:
        """Nothing is ever sent."""
        return None

    @property
    def commands(self) -> bool:
        """The operator takes the time that it takes."""
        return False

    def missing(self) -> str:
        """Nothing is needed."""
        return ""

    def move(self, trajectory: Trajectory, done: Done) -> None:  # noqa: ARG002  # the joint states tell
        """Ask the operator."""
        angles = ", ".join(f"{angle:.3f}" for angle in np.degrees(trajectory.position[-1]))
        self._ask(f"move the robot to {angles} degrees; only the hand on the pendant stops it")

    def stop(self) -> None:
        """Ask the operator."""
        self._ask("stop the robot: only your hand on the pendant can")

    def tick(self, now: float) -> None:
        """Nothing is awaited."""
