"""What a thermometer in the cell has shown so far: the newest value, and a thinned history of it."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from calibration_core.timeseries import Float2D

KEPT = 4000  # temperatures
SPACING = 5.0  # s between two temperatures that are kept
SILENT = 120.0  # s, after which the value that was heard last is no longer the temperature


class TemperatureHistory:
    """Gathers temperatures."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._newest: tuple[float, float] | None = None
        self._kept: deque[tuple[float, float]] = deque(maxlen=KEPT)

    def hear(self, seconds: float, value: float) -> None:
        """Take in a temperature, degrees Celsius; one that is not finite is the newest value, but no history.

        A clock that was set back begins a new spacing, it does not stop the history.
        """
        self._newest = seconds, value
        old = self._kept[-1][0] if self._kept else -math.inf
        if math.isfinite(value) and not 0.0 <= seconds - old < SPACING:
            self._kept.append((seconds, value))

    def at(self, now: float) -> float:
        """Return the temperature at a time, s; NaN where the thermometer is silent, or has shown no number."""
        if self._newest is None or not math.isfinite(self._newest[1]):
            return math.nan
        return self._newest[1] if abs(now - self._newest[0]) <= SILENT else math.nan

    def history(self, now: float) -> Float2D:
        """Return (k, 2) s and degrees Celsius in the order in which they came, the last one as of `now`, s.

        That one is NaN where the thermometer is silent now; nothing is returned where it never said anything.
        """
        latest = [] if self._newest is None else [(now, self.at(now))]
        return np.array([*self._kept, *latest], dtype=np.float64).reshape(-1, 2)
