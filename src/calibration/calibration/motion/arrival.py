"""Whether the robot stands still, and whether it stands where it was sent: from joint states alone."""

from __future__ import annotations

import collections
import dataclasses

import numpy as np

from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Int1D


@dataclasses.dataclass(frozen=True)
class ArrivalRules:
    """When a robot has arrived.

    Attributes:
        tolerance: rad, of every joint, from where it was sent.
        speed: rad/s, no joint is faster while it stands.
        dwell: s, for which both hold.
    """

    tolerance: float = 2e-3
    speed: float = 2e-3
    dwell: float = 0.3


class Joints:
    """The joint states of the last seconds, by their own stamps."""

    def __init__(self, rules: ArrivalRules, keep: float = 60.0) -> None:
        """Keep samples for `keep` s."""
        self._rules, self._keep = rules, round(keep * NANOSECONDS)
        self._samples: collections.deque[tuple[int, Float1D]] = collections.deque()

    def add(self, stamp: int, q: Float1D) -> None:
        """Take a sample: ns, (n,) rad.  Samples that are not finite, or not later than the last, are passed over."""
        if not np.isfinite(q).all():
            return
        if self._samples and stamp <= self._samples[-1][0]:
            if stamp < self._samples[-1][0] - NANOSECONDS:  # the clock went back: begin anew
                self._samples.clear()
            else:
                return
        self._samples.append((stamp, q))
        while self._samples[0][0] < stamp - self._keep:
            self._samples.popleft()

    @property
    def latest(self) -> Float1D | None:
        """The last sample, (n,) rad."""
        return self._samples[-1][1] if self._samples else None

    @property
    def until(self) -> int:
        """Stamp of the last sample, ns; 0 before the first."""
        return self._samples[-1][0] if self._samples else 0

    def reached(self, seconds: float) -> bool:
        """Whether samples of that moment, s by their stamps, or of later have come."""
        return self.until >= seconds * NANOSECONDS

    def standing(self) -> bool:
        """Whether every joint has kept still for the dwell; not before joint states of so long a time have come."""
        spread, span, known = self._lately()
        return known and bool(np.all(spread <= self._rules.speed * span))

    def moving(self) -> bool:
        """Whether a joint has moved within the dwell; joint states of a shorter time may show neither this nor rest."""
        spread, span, _ = self._lately()
        return bool(np.any(spread > self._rules.speed * max(span, self._rules.dwell)))

    def _lately(self) -> tuple[Float1D, float, bool]:
        """Return how far the joints moved (n,) rad, in how many seconds, and whether a whole dwell is known."""
        samples = list(self._samples)
        if len(samples) < 2:
            return np.zeros(0), 0.0, False
        end = samples[-1][0]
        recent = [(t, q) for t, q in samples if t >= end - round(self._rules.dwell * NANOSECONDS)]
        known = len(recent) < len(samples)
        if len(recent) < 2:
            recent = samples[-2:]
        span = (recent[-1][0] - recent[0][0]) / NANOSECONDS
        return np.ptp(np.array([q for _, q in recent]), axis=0), span, known

    def arrived(self, goal: Float1D) -> bool:
        """Whether the robot stands at `goal` (n,) rad."""
        latest = self.latest
        near = latest is not None and bool(np.all(np.abs(latest - goal) <= self._rules.tolerance))
        return near and self.standing()

    def between(self, begin: int, end: int) -> tuple[Int1D, Float2D]:
        """Return the stamps (k,) ns and angles (k, n) rad of a stretch of time, both ends included."""
        rows = [(t, q) for t, q in list(self._samples) if begin <= t <= end]
        stamps = np.array([t for t, _ in rows], dtype=np.int64)
        width = len(self._samples[-1][1]) if self._samples else 0
        return stamps, np.array([q for _, q in rows], dtype=np.float64).reshape(len(rows), width)
