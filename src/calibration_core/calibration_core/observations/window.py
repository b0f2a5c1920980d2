"""Averages over a settled window of a stream that is still arriving.

The window is the last so many seconds that lie wholly after the start, without a gap and settled by the same test as in
a recording; until there is one, the window slides on.
"""

from __future__ import annotations

import collections
import dataclasses

import numpy as np

from calibration_core.observations.average import Average, average
from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Int1D

MIN_SAMPLES = 8
SIGNIFICANCE = 5.0  # standard errors
PARTS = (0.0, 0.25, 0.5)  # how much of the beginning may be given up


def settled_from(time: Int1D, values: Float2D, tolerance: Float1D) -> int | None:
    """Find the sample from which a window is settled.

    A part of the window is settled unless the straight line through it rises or falls by more than the tolerance in
    some component, and by more than five of its standard errors.

    Args:
        time: (n,) ns.
        values: (n, k).
        tolerance: (k,) change over the window that does not matter.

    Returns:
        Index of the first settled sample: 0, a quarter or half of the way; None if not even the second half is
        settled.  Fewer than eight samples are taken as they are.
    """
    for part in PARTS:
        begin = int(part * len(time))
        if len(time) - begin < MIN_SAMPLES:
            return 0 if part == 0.0 else None
        drift, error = line_drift(time[begin:], values[begin:])
        if not ((np.abs(drift) > tolerance) & (np.abs(drift) > SIGNIFICANCE * error)).any():
            return begin
    return None


def line_drift(time: Int1D, values: Float2D) -> tuple[Float1D, Float1D]:
    """Fit a straight line to samples (n, k) and return its change over the window and the standard error of that."""
    t = (time - time[0]).astype(np.float64)
    span = float(t[-1])
    if span <= 0.0:
        return np.zeros(values.shape[1]), np.zeros(values.shape[1])
    t = t / span - (t / span).mean()
    power = float(t @ t)
    centred = values - values.mean(axis=0)
    drift = t @ centred / power
    rest = centred - np.outer(t, drift)
    variance = (rest**2).sum(axis=0) / max(len(t) - 2, 1)
    return np.asarray(drift), np.asarray(np.sqrt(variance / power))


@dataclasses.dataclass(frozen=True, eq=False)
class SettledWindow:
    """A settled window.

    Attributes:
        begin: Stamp of its first sample, ns.
        end: Stamp of its last sample, ns.
        average: Mean and covariance of the mean.
    """

    begin: int
    end: int
    average: Average


@dataclasses.dataclass(frozen=True, eq=False)
class Waiting:
    """Why there is no settled window yet.

    Attributes:
        share: How much of a window without a gap there is, 0 to 1.
        samples: Samples in it.
        moving: Whether the window is full but still moves.
    """

    share: float
    samples: int
    moving: bool


class Averaging:
    """Collects the samples of one stream until a window has settled."""

    def __init__(self, start: int, window: float, tolerance: Float1D, min_samples: int) -> None:
        """Start with no sample.

        Args:
            start: Stamp before which no sample counts, ns.
            window: Length of the window, s, positive.
            tolerance: (k,) change over the window that does not matter.
            min_samples: Samples that a window must have, at least 1.
        """
        self._start = start
        self._window = round(window * NANOSECONDS)
        self._tolerance = np.asarray(tolerance)
        self._min_samples = min_samples
        self._time: collections.deque[int] = collections.deque()
        self._values: collections.deque[Float1D] = collections.deque()

    def add(self, time: int, values: Float1D) -> None:
        """Take a sample that passed its checks; stamps must increase."""
        if time < self._start:
            return
        self._time.append(time)
        self._values.append(values)
        while len(self._time) > 2 and self._time[1] <= time - self._window:
            self._time.popleft()
            self._values.popleft()

    def break_off(self) -> None:
        """Forget what was collected: samples are missing, or were rejected."""
        self._time.clear()
        self._values.clear()

    def state(self) -> SettledWindow | Waiting:
        """Return the settled window, or why there is none yet."""
        samples = len(self._time)
        span = self._time[-1] - self._time[0] if samples else 0
        share = min(span / self._window, samples / self._min_samples, 1.0)
        if span < self._window or samples < self._min_samples:
            return Waiting(share, samples, moving=False)
        time, values = np.array(self._time, np.int64), np.array(self._values)
        if settled_from(time, values, self._tolerance) != 0:
            return Waiting(1.0, samples, moving=True)
        return SettledWindow(int(time[0]), int(time[-1]), average(values))
