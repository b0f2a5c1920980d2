"""Whether the robot stands still, and whether it stands where it was sent: from joint states alone."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Int1D

RATE_TIME = 0.05  # s, over which a rate is measured, or from one sample to the next: 1e-5 rad of noise are 0.2 mrad/s
ROWS = 1024  # that are kept at first


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


@dataclasses.dataclass(frozen=True, eq=False)
class _Kept:
    """Samples in the order of time, in the rows `begin` to `end` of arrays that are filled up and never changed."""

    stamps: Int1D
    q: Float2D
    begin: int = 0
    end: int = 0

    def since(self, stamp: int) -> int:
        """Return the row of the first sample of a moment (ns) or of later."""
        return self.begin + int(np.searchsorted(self.stamps[self.begin : self.end], stamp))


class Joints:
    """The joint states of the last seconds, by their own stamps; one thread adds them, any may ask."""

    def __init__(self, rules: ArrivalRules, keep: float = 60.0) -> None:
        """Keep samples for `keep` s."""
        self._rules, self._keep = rules, round(keep * NANOSECONDS)
        self._kept = _Kept(np.empty(0, dtype=np.int64), np.empty((0, 0)))

    def add(self, stamp: int, q: Float1D) -> None:
        """Take a sample: ns, (n,) rad.  Samples that are not finite, or not later than the last, are passed over."""
        if not np.isfinite(q).all():
            return
        kept = self._kept
        if kept.end > kept.begin and stamp <= self.until:
            if stamp >= self.until - NANOSECONDS:
                return
            kept = dataclasses.replace(kept, begin=kept.end)  # the clock went back: begin anew
        begin = kept.since(stamp - self._keep)
        if kept.end == len(kept.stamps) or kept.q.shape[1] != len(q):
            kept, begin = _moved(kept, begin, len(q)), 0
        kept.stamps[kept.end], kept.q[kept.end] = stamp, q
        self._kept = dataclasses.replace(kept, begin=begin, end=kept.end + 1)

    @property
    def latest(self) -> Float1D | None:
        """The last sample, (n,) rad."""
        kept = self._kept
        return kept.q[kept.end - 1].copy() if kept.end > kept.begin else None

    @property
    def until(self) -> int:
        """Stamp of the last sample, ns; 0 before the first."""
        kept = self._kept
        return int(kept.stamps[kept.end - 1]) if kept.end > kept.begin else 0

    def course(self, now: int) -> tuple[Float1D, Float1D, float] | None:
        """Return where the robot was seen last (n,) rad, how fast (n,) rad/s, and how long ago (s) at `now`, ns.

        None where no joint states have come.
        """
        kept = self._kept
        if kept.end == kept.begin:
            return None
        last = kept.end - 1
        first = max(min(kept.since(int(kept.stamps[last]) - round(RATE_TIME * NANOSECONDS)), last - 1), kept.begin)
        span = (int(kept.stamps[last]) - int(kept.stamps[first])) / NANOSECONDS
        rate = (kept.q[last] - kept.q[first]) / span if span > 0.0 else np.zeros(kept.q.shape[1])
        return kept.q[last].copy(), rate, (now - int(kept.stamps[last])) / NANOSECONDS

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
        kept = self._kept
        if kept.end - kept.begin < 2:
            return np.zeros(0), 0.0, False
        first = kept.since(int(kept.stamps[kept.end - 1]) - round(self._rules.dwell * NANOSECONDS))
        known, first = first > kept.begin, min(first, kept.end - 2)
        span = (int(kept.stamps[kept.end - 1]) - int(kept.stamps[first])) / NANOSECONDS
        return np.ptp(kept.q[first : kept.end], axis=0), span, known

    def arrived(self, goal: Float1D) -> bool:
        """Whether the robot stands at `goal` (n,) rad."""
        latest = self.latest
        near = latest is not None and bool(np.all(np.abs(latest - goal) <= self._rules.tolerance))
        return near and self.standing()

    def between(self, begin: int, end: int) -> tuple[Int1D, Float2D]:
        """Return the stamps (k,) ns and angles (k, n) rad of a stretch of time, both ends included."""
        kept = self._kept
        rows = slice(kept.since(begin), kept.since(end + 1))
        return kept.stamps[rows].copy(), kept.q[rows].copy()


def _moved(kept: _Kept, begin: int, width: int) -> _Kept:
    """Return the samples from a row on in arrays that have room for as many again; none where the width differs."""
    end = kept.end if kept.q.shape[1] == width else begin
    count = end - begin
    stamps, q = np.empty(max(2 * count, ROWS), dtype=np.int64), np.empty((max(2 * count, ROWS), width))
    if count:
        stamps[:count], q[:count] = kept.stamps[begin:end], kept.q[begin:end]
    return _Kept(stamps, q, 0, count)
