"""Trackers with one beam: a driver aims at one target, then measures it; nothing here knows of ROS or of the robot."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

from calibration_core.timeseries import Float1D, Float2D

AXES = ("x", "y", "z")
Wait = Callable[[], int]
"""Waits a moment and returns the time, ns; raises where nobody wants the answer any more, or it comes too late."""


class DriverError(Exception):
    """The tracker did not do what it was asked, or its answer cannot be used; the text says what it did."""


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """A place that the tracker states.

    Attributes:
        begin: When it was asked for, ns.
        end: When it was stated, ns, later than that: the target was measured in between.
        place: (3,) m, tracker frame.
        covariance: (3, 3) m^2; None where the tracker states none.
    """

    begin: int
    end: int
    place: Float1D
    covariance: Float2D | None = None


class Driver(Protocol):
    """One tracker.  Its methods wait; one thread calls them at a time."""

    name: str  # of the tracker, for a person
    by_hand: bool  # whether a person aims, or measures
    awaited: str  # what is missing while it waits, for a person

    def aim(self, point: str, place: Float1D, wait: Wait) -> None:
        """Point the beam at a target that should be at (3,) m, tracker frame; what was stated before counts no more.

        Raises:
            DriverError: There is no target, or no tracker.
        """

    def measure(self, window: float, wait: Wait) -> list[Seen]:
        """Measure the target for so many s at least; return at least one place, in the order of time.

        Raises:
            DriverError: The beam is broken, or the answer cannot be used.
        """

    def close(self) -> None:
        """Give back what is held; it is taken again when it is needed."""
