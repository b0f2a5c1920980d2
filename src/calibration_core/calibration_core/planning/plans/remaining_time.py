"""The time left of a run: what the plan expects of it, at the pace of what is done."""

from __future__ import annotations

import math


class RemainingTime:
    """Estimates the time left; waiting and pauses do not change it.

    Work is counted in nominal seconds.  What one of them takes is what the plan expects, until enough is done.
    """

    def __init__(self, expected_pace: float, enough: float) -> None:
        """Begin to count.

        Args:
            expected_pace: s that the plan expects for a nominal second; NaN: it expects nothing.
            enough: Nominal seconds of work after which the pace is known.
        """
        self._expected_pace, self._enough = expected_pace, enough
        self._now = math.nan
        self._worked = 0.0  # s so far
        self._done = self._took = 0.0  # nominal seconds of what is done, and s worked until then

    def pass_to(self, now: float, *, working: bool) -> None:
        """Take the time on the caller's clock, s, and whether work was done since it was taken last."""
        self._worked += now - self._now if working else 0.0
        self._now = now

    def count(self, nominal: float) -> None:
        """Take nominal seconds of work that have just been done."""
        if nominal > 0.0:
            self._done, self._took = self._done + nominal, self._worked

    def of(self, nominal: float) -> float:
        """Return how long nominal seconds of work take, s; NaN: unknown yet."""
        if nominal <= 0.0:
            return 0.0
        return nominal * (self._expected_pace if self._done < self._enough else self._took / self._done)
