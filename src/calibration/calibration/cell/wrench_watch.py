"""The wrench as it streams: what pulls now, before anything is averaged for a reading."""

from __future__ import annotations

import collections
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy

from calibration.conversions import stamp_ns, wrench_values
from calibration.topics import TARE, subscribe_to_samples
from calibration_core.timeseries import NANOSECONDS, Float1D

MEAN = 0.5  # s of the cell's time, over which the present wrench is averaged
KEPT = 1000  # samples
LOOK = 0.02  # s of wall time between looks at the wrench, far less than what is averaged
FRESH = 1.0  # s of wall time; an older last sample says nothing about now


class WrenchWatch:
    """Hears the wrench and the tares.

    Attributes:
        topic: Where the wrench comes from.
        tares: How many tares have been told.
        tare: Number of the last one.
    """

    def __init__(self, node: Any) -> None:
        """Prepare; `listen` begins."""
        self._node, self.topic = node, node.cell.topics.wrench
        self._samples: collections.deque[tuple[int, Float1D]] = collections.deque(maxlen=KEPT)
        self._heard = -np.inf  # s of the steady clock
        self._biases: dict[int, Float1D] = {}  # by the number of the tare
        self.tares = self.tare = 0

    def listen(self) -> None:
        """Listen to wrench and tares."""
        newest = QoSProfile(depth=KEPT, reliability=ReliabilityPolicy.BEST_EFFORT)
        subscribe_to_samples(self._node, WrenchStamped, self.topic.lstrip("/"), self._on_wrench, newest, every=LOOK)
        self._node.create_subscription(TARE.message, TARE.relative, self._on_tare, TARE.qos)

    def _on_wrench(self, message: WrenchStamped) -> None:
        values = wrench_values(message.wrench)
        if np.isfinite(values).all():
            self._heard = time.monotonic()
            self._samples.append((stamp_ns(message.header.stamp) or self._node.now_ns(), values))

    def _on_tare(self, message: Any) -> None:
        self.tares, self.tare = self.tares + 1, int(message.number)
        self._biases[self.tare] = wrench_values(message.bias)

    def bias(self, tare: int) -> Float1D:
        """Return what a tare subtracts, (6,) N and N*m."""
        return self._biases.get(tare, np.zeros(6))

    @property
    def now(self) -> Float1D | None:
        """The mean (6,) N and N*m of the last half second; None where the sensor is silent."""
        samples = list(self._samples)
        if not samples or time.monotonic() - self._heard > FRESH:
            return None
        since = samples[-1][0] - round(MEAN * NANOSECONDS)
        return np.asarray(np.mean([values for stamp, values in samples if since <= stamp <= samples[-1][0]], axis=0))
