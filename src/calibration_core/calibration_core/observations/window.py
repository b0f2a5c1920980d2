"""Averages over a settled window of a stream that is still arriving.

The window is the last so many seconds that lie wholly after the start, without a gap and settled by the same test as in
a recording; until there is one, the window slides on.
"""

from __future__ import annotations

import collections
import dataclasses

import numpy as np

from calibration_core.observations.average import Average, average
from calibration_core.observations.settling import settled_from
from calibration_core.timeseries import NANOSECONDS, Float1D


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
