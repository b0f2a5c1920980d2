"""The staged stop: the next stage is taken when the one before has not brought the robot to rest in time.

    cancel the goal -> hold trajectory on the controller's topic -> the maker's stop service -> tell the operator

No stage is safety-rated.
"""

from __future__ import annotations

import math

PATIENCE = 0.5  # s, between two stages


class StopStages:
    """Which stages are due."""

    def __init__(self, stages: int, patience: float = PATIENCE) -> None:
        """Begin at rest.

        Args:
            stages: How many there are.
            patience: s, between two of them.
        """
        self._stages, self._patience = stages, patience
        self._next, self._due = stages, math.inf

    @property
    def under_way(self) -> bool:
        """Whether a stop is under way."""
        return math.isfinite(self._due)

    def begin(self, now: float) -> int:
        """Begin to stop at `now` (s, steady); return the first stage.  A stop under way goes on from where it is."""
        if not self.under_way:
            self._next, self._due = 1, now + self._patience
        return 0

    def advance(self, now: float, *, standing: bool) -> int | None:
        """Return the stage that is due at `now`, if any; it ends when the robot stands."""
        if not self.under_way:
            return None
        if standing:
            self._due = math.inf
            return None
        if now < self._due or self._next >= self._stages:
            return None
        stage, self._next, self._due = self._next, self._next + 1, now + self._patience
        return stage
