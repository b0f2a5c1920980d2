"""The stop ladder: the next rung is taken when the one before has not brought the robot to rest in time.

    cancel the goal -> hold trajectory on the controller's topic -> the maker's stop service -> tell the operator

No rung is safety-rated.
"""

from __future__ import annotations

import math

PATIENCE = 0.5  # s, between two rungs


class StopLadder:
    """Which rungs are due."""

    def __init__(self, rungs: int, patience: float = PATIENCE) -> None:
        """Begin at rest.

        Args:
            rungs: How many there are.
            patience: s, between two of them.
        """
        self._rungs, self._patience = rungs, patience
        self._next, self._due = rungs, math.inf

    @property
    def climbing(self) -> bool:
        """Whether a stop is under way."""
        return math.isfinite(self._due)

    def begin(self, now: float) -> int:
        """Begin to stop at `now` (s, steady); return the first rung.  A stop under way goes on from where it is."""
        if not self.climbing:
            self._next, self._due = 1, now + self._patience
        return 0

    def climb(self, now: float, *, standing: bool) -> int | None:
        """Return the rung that is due at `now`, if any; the ladder ends when the robot stands."""
        if not self.climbing:
            return None
        if standing:
            self._due = math.inf
            return None
        if now < self._due or self._next >= self._rungs:
            return None
        rung, self._next, self._due = self._next, self._next + 1, now + self._patience
        return rung
