"""What a thermometer in the cell has shown so far: the newest value, and a thinned history of it."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from calibration_core.timeseries import Float2D

KEPT = 4000  # temperatures
SPACING = 5.0  # s between two temperatures that are kept


class TemperatureHistory:
    """Gathers temperatures.

    Attributes:
        value: degrees Celsius, as last heard; NaN where nothing was.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self.value = math.nan
        self._kept: deque[tuple[float, float]] = deque(maxlen=KEPT)

    def hear(self, seconds: float, value: float) -> None:
        """Take in a temperature, degrees Celsius; one that is not finite is the newest value, but no history.

        A clock that was set back begins a new spacing, it does not stop the history.
        """
        self.value = value
        old = self._kept[-1][0] if self._kept else -math.inf
        if math.isfinite(value) and not 0.0 <= seconds - old < SPACING:
            self._kept.append((seconds, value))

    def history(self, now: float) -> Float2D:
        """Return (k, 2) s and degrees Celsius in the order in which they came, the newest value as of `now`, s."""
        latest = [] if math.isnan(self.value) else [(now, self.value)]
        return np.array([*self._kept, *latest], dtype=np.float64).reshape(-1, 2)
