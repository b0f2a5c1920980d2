"""Looking at a played world through instruments that are not quite what their sheets claim.

The tracker errs in range, azimuth and elevation of its own frame, in some recordings slowly (air turbulence); its sheet
may state the same error per coordinate, too small or too large.  The force/torque sensor is noisy and lags a little.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell, Tracker
from calibration_core.timeseries import Float2D, Float3D, Provenance, Readings
from calibration_sim.cell.protocol import rated_force
from calibration_sim.cell.sensors import quantise, tracker_error
from calibration_sim.cell.table import wrench_sigma
from calibration_sim.effects.chains import SensorHysteresis
from calibration_sim.effects.effect import Label
from calibration_sim.scenarios.world import Played, World

SLOW_SHARE = 0.5  # of the variance, where the noise is correlated
SLOW_MEMORY = 0.6  # from one step to the next
SENSOR_LAG = 1e-3  # of the range to either side: 0.2 percent in all
RANGE_SHARE = 0.3  # change of load, of the range, that turns the lag over
TORQUE_ARM = 0.3  # m, torque range over force range
TEMPERATURE_SIGMA = 0.1
TRACKER_RESOLUTION, FORCE_RESOLUTION = 1e-7, 1e-2


@dataclasses.dataclass(frozen=True)
class Noise:
    """How the instruments err in one recording.

    Attributes:
        factor: Real over claimed standard deviation of the tracker.
        correlated: Whether part of the tracker's noise is slow and common to all points.
        outlier_rate: Share of wild readings.
        outlier_size: m, standard deviation per coordinate.
        spherical_claim: Whether the cell file states the error in spherical coordinates; otherwise per coordinate.
    """

    factor: float = 1.0
    correlated: bool = False
    outlier_rate: float = 0.0
    outlier_size: float = 5e-4
    spherical_claim: bool = False


def spherical_tracker(cell: Cell, points: Float3D) -> Tracker:
    """Return a tracker that errs in spherical coordinates, over points (s, p, 3) as much as the cell's claim."""
    sigma = float(cell.instruments.tracker.sigma or 0.0)
    distance = float(np.sqrt(np.mean(np.sum(points**2, axis=-1))))
    along = 0.5 * sigma
    across = np.sqrt((3.0 * sigma**2 - along**2) / 2.0)
    return Tracker(sigma_range=along, sigma_angle=float(f"{across / distance:.3g}"))


def lagging_sensor(cell: Cell) -> SensorHysteresis:
    """Return the sensor's hysteresis, which every recording has."""
    size = rated_force(cell) * np.repeat([1.0, TORQUE_ARM], 3)
    return SensorHysteresis(Label("load chain", "sensor_hysteresis", {}), SENSOR_LAG * size, RANGE_SHARE * size)


def look(world: World, played: Played, points: tuple[str, ...], noise: Noise, seed: int) -> Readings:
    """Return what is recorded."""
    rng = np.random.default_rng(seed)
    cell, faults = world.cell, world.sensors.tracker
    names = tuple(world.truth.points)
    chosen = [names.index(name) for name in points]
    true = played.points[:, chosen]
    steps, count = true.shape[:2]
    normal = _normal(rng, steps, count, noise)
    flat = true.reshape(-1, 3)
    error = noise.factor * faults.noise_factor * tracker_error(flat, spherical_tracker(cell, true), normal)
    for rate, size in ((noise.outlier_rate, noise.outlier_size), (faults.outlier_rate, faults.outlier_size)):
        wild = rng.random(len(flat)) < rate
        error += np.where(wild[:, None], size * rng.standard_normal(flat.shape), 0.0)
    wrench = None
    if cell.frames.wrench_point is not None and np.any(played.wrench != 0.0):
        shown = played.wrench + wrench_sigma(cell) * rng.standard_normal((steps, 6))
        wrench = np.repeat(quantise(shown, FORCE_RESOLUTION), count, axis=0)
    temperature = played.temperature + TEMPERATURE_SIGMA * rng.standard_normal(steps)
    return Readings(
        points=points,
        configuration=np.repeat(played.configuration, count),
        step=np.repeat(played.step, count),
        point=np.tile(np.arange(count), steps),
        q=np.repeat(played.q, count, axis=0),
        position=quantise(flat + error, TRACKER_RESOLUTION),
        wrench=wrench,
        time=np.repeat(played.time, count) + np.tile(np.arange(count), steps),
        temperature=np.repeat(np.round(temperature, 2), count),
        provenance=Provenance("simulation", "csv", {}, {"measurements": len(flat)}),
    )


def _normal(rng: np.random.Generator, steps: int, count: int, noise: Noise) -> Float2D:
    """Return standard normal numbers (steps x count, 3): range, azimuth, elevation."""
    fast = rng.standard_normal((steps, count, 3))
    if not noise.correlated:
        return np.asarray(fast.reshape(-1, 3))
    slow = rng.standard_normal((steps, 1, 3))
    for k in range(1, steps):
        slow[k] = SLOW_MEMORY * slow[k - 1] + np.sqrt(1.0 - SLOW_MEMORY**2) * slow[k]
    return np.asarray((np.sqrt(1.0 - SLOW_SHARE) * fast + np.sqrt(SLOW_SHARE) * slow).reshape(-1, 3))
