"""What pulls now, before anything is averaged for a reading: the sensor's node tells its mean, not every sample."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from calibration.conversions import wrench_values
from calibration.rclpy_gaps import Waiting
from calibration.topics import PRESENT_WRENCH, TARE
from calibration_core.timeseries import Float1D

FRESH = 1.0  # s of wall time; an older last mean says nothing about now


class WrenchWatch:
    """Hears the present wrench and the tares.

    Attributes:
        topic: Where the wrench comes from.
        tares: How many tares have been told.
        tare: Number of the last one.
    """

    def __init__(self, node: Any) -> None:
        """Listen."""
        self.topic = node.cell.topics.wrench
        self._waiting = Waiting(node, PRESENT_WRENCH.message, PRESENT_WRENCH.relative, PRESENT_WRENCH.qos)
        self._heard, self._mean = -np.inf, np.zeros(6)  # s of the steady clock
        self._biases: dict[int, Float1D] = {}  # by the number of the tare
        self.tares = self.tare = 0
        node.create_subscription(TARE.message, TARE.relative, self._on_tare, TARE.qos)

    def take(self) -> None:
        """Take what has come; to be called some times in `FRESH`."""
        for message in self._waiting.take():
            self._mean, self._heard = wrench_values(message.wrench), time.monotonic()

    def _on_tare(self, message: Any) -> None:
        self.tares, self.tare = self.tares + 1, int(message.number)
        self._biases[self.tare] = wrench_values(message.bias)

    def bias(self, tare: int) -> Float1D:
        """Return what a tare subtracts, (6,) N and N*m."""
        return self._biases.get(tare, np.zeros(6))

    @property
    def now(self) -> Float1D | None:
        """The mean (6,) N and N*m of the last half second; None where the sensor is silent."""
        return None if time.monotonic() - self._heard > FRESH else self._mean
