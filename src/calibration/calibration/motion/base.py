"""What a back end does: take one trajectory at a time, tell how it ended, stop."""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Protocol

from calibration_core.motion.trajectory import Trajectory
from calibration_core.timeseries import Float1D


class End(enum.Enum):
    """How a trajectory ended, by the driver's word."""

    SUCCESS = "success"  # which is not arrival: whoever moves checks the joint states
    FAILURE = "failure"
    CANCELLED = "cancelled by somebody else"


Done = Callable[[End, str], None]
"""Called once when a trajectory has ended: how, and the driver's words."""


class Backend(Protocol):
    """A way to move the robot.  Methods return at once; `done` may be called from another thread."""

    def missing(self) -> str:
        """Return what is missing of the driver now; empty if nothing is."""

    def move(self, trajectory: Trajectory, done: Done) -> None:
        """Follow a trajectory; the one before, if any, is over."""

    def stop(self) -> None:
        """Stop what is being followed, at once; nothing if nothing is.  May be called again and from any thread."""

    def tick(self, now: float) -> None:
        """Look for answers that do not come; `now` is s of the steady clock."""

    @property
    def answers(self) -> bool:
        """Whether `done` is ever called."""

    @property
    def goal(self) -> bytes | None:
        """Identifier of the goal under way, 16 bytes, zeros where there are no goals; None: none was accepted yet."""

    @property
    def commands(self) -> bool:
        """Whether the robot moves by our command, so that arrival may be awaited for a limited time only."""


class Course(Protocol):
    """Tells where the robot is, and how it moves."""

    def __call__(self) -> tuple[Float1D, Float1D, float] | None:
        """Return joint angles (n,) rad, rates (n,) rad/s, and their age, s, as measured; None if nothing is known."""
