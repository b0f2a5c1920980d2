"""The instruments of the living cell: one sample at a time, with the noise that `stream_noise` gives whole streams."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate

import numpy as np

from calibration_core.cell import Cell
from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.cell.sensors import SLOW_SHARE, SLOW_TIME, quantise, read_tracker, read_wrench
from calibration_sim.cell.streams import THERMOMETER_RESOLUTION, Rates
from calibration_sim.cell.table import wrench_sigma
from calibration_sim.cell.truth import NOISE_STREAM, Truth, generator

BLOCK = 250  # samples whose noise is drawn at once


class LiveNoise:
    """Noise of which the mean over one window has variance one: half white, half first-order Gauss-Markov."""

    def __init__(self, rng: np.random.Generator, columns: int, *, rate: float, window: float) -> None:
        """See `calibration_sim.cell.sensors.stream_noise`."""
        n = max(1, round(rate * window))
        self._memory = float(np.exp(-1.0 / (rate * SLOW_TIME)))
        lag = np.arange(1, n)
        variance_of_mean = (n + 2.0 * float(np.sum((n - lag) * self._memory**lag))) / n**2
        self._white, self._slow = np.sqrt((1.0 - SLOW_SHARE) * n), np.sqrt(SLOW_SHARE / variance_of_mean)
        self._rng, self._state = rng, rng.standard_normal(columns)
        self._samples = self._drawn()

    def next(self) -> Float1D:
        """Return the noise (columns,) of the next sample."""
        return next(self._samples)

    def _drawn(self) -> Iterator[Float1D]:
        memory = self._memory
        while True:
            white, drive = self._rng.standard_normal((2, BLOCK, len(self._state)))
            drive *= np.sqrt(1.0 - memory**2)
            slow: Float2D = np.empty_like(drive)
            for column, begin in enumerate(self._state.tolist()):
                states = accumulate(drive[:, column].tolist(), lambda last, new: memory * last + new, initial=begin)
                slow[:, column] = list(states)[1:]
            self._state = slow[-1]
            yield from self._white * white + self._slow * slow


class LiveSensors:
    """What the instruments show of the truth, sample by sample."""

    def __init__(self, cell: Cell, truth: Truth, seed: int, *, rates: Rates, window: float) -> None:
        """Set the instruments up.

        Args:
            cell: Its instruments' claims scale the noise.
            truth: Its instruments' faults.
            seed: Of the noise.
            rates: Sampling rates, Hz.
            window: s, the averaging window over which the claims hold.
        """
        self._cell, self._sensors, self._wrench_sigma = cell, truth.sensors, wrench_sigma(cell)
        self._rng = generator(seed, NOISE_STREAM)
        self._points = [LiveNoise(self._rng, 3, rate=rates.tracker, window=window) for _ in truth.points]
        self._wrench = LiveNoise(self._rng, 6, rate=rates.wrench, window=window)

    def point(self, index: int, position: Float1D) -> Float1D:
        """Return what the tracker shows of a point that is at (3,) m, tracker frame."""
        noise = self._points[index].next()[None]
        tracker = self._cell.instruments.tracker
        return read_tracker(position[None], tracker, self._sensors.tracker, noise, self._rng)[0]

    def wrench(self, wrench: Float1D) -> Float1D:
        """Return what the force/torque sensor shows of a wrench (6,) N and N*m."""
        noise = self._wrench.next()[None]
        return read_wrench(wrench[None], self._wrench_sigma, self._sensors.force_torque, noise)[0]

    def temperature(self) -> float:
        """Return what the thermometer shows, degrees Celsius."""
        claim = self._cell.instruments.temperature
        sigma = 0.0 if claim is None else claim.sigma
        shown = np.array([[self._sensors.temperature + sigma * self._rng.standard_normal()]])
        return float(quantise(shown, THERMOMETER_RESOLUTION)[0, 0])
