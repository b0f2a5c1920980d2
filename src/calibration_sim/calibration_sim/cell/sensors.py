"""The instruments: what they add to the truth.

The cell file claims one standard deviation for one averaged reading.  Here are the noise that really comes (the claim
times a factor), the faults, and the order in which an instrument applies them: gain-free bias, noise, outliers, then
the resolution of its display.
"""

from __future__ import annotations

import dataclasses
from itertools import accumulate

import numpy as np

from calibration_core.cell import Tracker
from calibration_core.timeseries import Float1D, Float2D

SLOW_SHARE = 0.5  # of the variance of an averaged reading that does not average out within the window
SLOW_TIME = 1.0  # s, correlation time of that part (air turbulence, bridge drift)


@dataclasses.dataclass(frozen=True)
class TrackerFaults:
    """What is wrong with the tracker.

    Attributes:
        noise_factor: Real over claimed standard deviation.
        bias: m, added to every coordinate triple, tracker axes.
        resolution: m, last digit; 0: none.
        outlier_rate: Share of readings (stream: of samples) that are wild.
        outlier_size: m, standard deviation of a wild reading's error per coordinate.
    """

    noise_factor: float = 1.0
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    resolution: float = 1e-7
    outlier_rate: float = 0.0
    outlier_size: float = 5e-4


@dataclasses.dataclass(frozen=True)
class ForceTorqueFaults:
    """What is wrong with the force/torque sensor.

    Attributes:
        noise_factor: Real over claimed standard deviation.
        bias: N and N*m, sensor axes: what taring left.
        resolution_force: N, last digit; 0: none.
        resolution_torque: N*m, last digit; 0: none.
        clock_offset: s, its stamps minus everyone else's; concerns streams only.
    """

    noise_factor: float = 1.0
    bias: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    resolution_force: float = 0.1
    resolution_torque: float = 0.02
    clock_offset: float = 0.0


@dataclasses.dataclass(frozen=True)
class Sensors:
    """All instruments of a cell.

    Attributes:
        tracker: Faults of the tracker.
        force_torque: Faults of the force/torque sensor.
        temperature: True temperature of the cell, degrees Celsius.
        one_after_another: Concerns tables only.  The tracker goes from point to point, so that each has
            wrench and temperature readings of its own; otherwise all points of a step are read at once and share them.
    """

    tracker: TrackerFaults = TrackerFaults()
    force_torque: ForceTorqueFaults = ForceTorqueFaults()
    temperature: float = 20.0
    one_after_another: bool = False


SOUND = Sensors()  # noise as claimed, a display's resolution, no fault


def quantise(values: Float2D, resolution: float | Float1D) -> Float2D:
    """Round to multiples of the resolution; 0 leaves a value as it is."""
    resolution = np.broadcast_to(np.asarray(resolution, dtype=np.float64), values.shape)
    result = np.array(values, dtype=np.float64)
    coarse = resolution > 0.0
    result[coarse] = np.round(result[coarse] / resolution[coarse]) * resolution[coarse]
    return result


def tracker_error(position: Float2D, instrument: Tracker, normal: Float2D) -> Float2D:
    """Turn standard normal numbers (m, 3) into tracker errors (m, 3) in m, tracker axes, at positions (m, 3) in m.

    A Cartesian claim gives independent coordinates.  A spherical claim errs in range, azimuth and elevation as seen
    from the tracker's origin: dp = n dr + e_az r cos(el) d_az + e_el r d_el.
    """
    if instrument.sigma is not None:
        return instrument.sigma * normal
    reach = np.linalg.norm(position, axis=1, keepdims=True)
    level = np.linalg.norm(position[:, :2], axis=1, keepdims=True)
    sight = position / reach
    east = np.column_stack([-position[:, 1], position[:, 0], np.zeros(len(position))]) / level
    up = np.cross(sight, east)
    along = (float(instrument.sigma_range or 0.0) + instrument.sigma_range_per_m * reach) * normal[:, :1]
    angle = float(instrument.sigma_angle or 0.0) * normal[:, 1:]
    return np.asarray(along * sight + level * angle[:, :1] * east + reach * angle[:, 1:] * up)


def read_tracker(
    position: Float2D, instrument: Tracker, faults: TrackerFaults, normal: Float2D, rng: np.random.Generator
) -> Float2D:
    """Return what the tracker shows (m, 3) for true positions (m, 3), tracker frame, m."""
    error = faults.noise_factor * tracker_error(position, instrument, normal)
    if faults.outlier_rate > 0.0:
        wild = rng.random(len(position)) < faults.outlier_rate
        error = error + np.where(wild[:, None], faults.outlier_size * rng.standard_normal(position.shape), 0.0)
    return quantise(position + np.array(faults.bias) + error, faults.resolution)


def read_wrench(wrench: Float2D, sigma: Float1D, faults: ForceTorqueFaults, normal: Float2D) -> Float2D:
    """Return what the force/torque sensor shows (m, 6) for true wrenches (m, 6), N and N*m, and claims sigma (6,)."""
    resolution = np.repeat([faults.resolution_force, faults.resolution_torque], 3)
    return quantise(wrench + np.array(faults.bias) + faults.noise_factor * sigma * normal, resolution)


def stream_noise(rng: np.random.Generator, samples: int, columns: int, *, rate: float, window: float) -> Float2D:
    """Return noise (samples, columns) of which the mean over one window has variance one.

    Half of that variance is white, half a first-order Gauss-Markov process of correlation time `SLOW_TIME`.
    """
    n = max(1, round(rate * window))
    memory = float(np.exp(-1.0 / (rate * SLOW_TIME)))
    lag = np.arange(1, n)
    variance_of_mean = (n + 2.0 * float(np.sum((n - lag) * memory**lag))) / n**2
    white = rng.standard_normal((samples, columns))
    drive = rng.standard_normal((samples, columns))
    drive[1:] *= np.sqrt(1.0 - memory**2)
    slow = np.empty_like(drive)
    for column in range(columns):  # SciPy's filter takes longer to load than this does
        slow[:, column] = list(accumulate(drive[:, column].tolist(), lambda last, new: memory * last + new))
    return np.asarray(np.sqrt((1.0 - SLOW_SHARE) * n) * white + np.sqrt(SLOW_SHARE / variance_of_mean) * slow)
