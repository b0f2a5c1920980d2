"""What is measured: configurations and, in each, the external wrench of every step.

A pull has a direction fixed in base axes (a cable over a pulley, a hanging weight) and acts at the wrench point.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calibration_core.cell import Cell
from calibration_core.errors import PlanError, quoted
from calibration_core.files.yaml_file import read_yaml
from calibration_core.timeseries import Float2D, read_only

STANDARD_ACCELERATION = 9.80665  # m/s^2, turns a rated load in kg into N
NINE_STEPS = (0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0)
FOUR_STEPS = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
MAX_PLAN_BYTES = 8 << 20


@dataclasses.dataclass(frozen=True, eq=False)
class Configuration:
    """One configuration and its steps.

    Attributes:
        number: As it is counted in recordings.
        q: (n,) rad, commanded.
        wrenches: (steps, 6) N and N*m, base axes, at the wrench point; step 0 first.
    """

    number: int
    q: np.ndarray[tuple[int], np.dtype[np.float64]]
    wrenches: Float2D

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        object.__setattr__(self, "q", read_only(self.q))
        object.__setattr__(self, "wrenches", read_only(self.wrenches))


@dataclasses.dataclass(frozen=True, eq=False)
class Protocol:
    """The configurations in the order in which they are measured."""

    configurations: tuple[Configuration, ...]

    @property
    def steps(self) -> int:
        """Number of steps of all configurations together."""
        return sum(len(configuration.wrenches) for configuration in self.configurations)


def rated_force(cell: Cell) -> float:
    """Return the weight of the rated load, N."""
    return cell.robot.rated_load * STANDARD_ACCELERATION


def pull(direction: ArrayLike, force: float, levels: tuple[float, ...] = NINE_STEPS) -> Float2D:
    """Return the wrenches (steps, 6) of a pull along `direction` (3,), base axes, at fractions of `force` (N)."""
    unit = np.asarray(direction, dtype=np.float64)
    unit = unit / np.linalg.norm(unit)
    return np.hstack([np.outer(levels, force * unit), np.zeros((len(levels), 3))])


def oblique_direction(rng: np.random.Generator, gravity: ArrayLike) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return a random unit direction (3,), 25 to 65 degrees off the downward vertical, any azimuth."""
    gravity = np.asarray(gravity, dtype=np.float64)
    size = float(np.linalg.norm(gravity))
    down = gravity / size if size > 0.0 else np.array([0.0, 0.0, -1.0])
    across = np.linalg.svd(down[None, :])[2][1:]
    tilt, azimuth = rng.uniform(np.radians(25.0), np.radians(65.0)), rng.uniform(0.0, 2.0 * np.pi)
    level = np.cos(azimuth) * across[0] + np.sin(azimuth) * across[1]
    return np.asarray(np.cos(tilt) * down + np.sin(tilt) * level)


def read_plan(path: str | Path, cell: Cell) -> Protocol:
    """Read `plan.yaml`: `configurations: [{number, q, spare, steps: [[fx, fy, fz, tx, ty, tz], ...]}, ...]`.

    Spare configurations are left out; other keys belong to other readers and are passed over.

    Raises:
        PlanError: The file is missing, malformed, or does not fit the cell.
    """
    file = read_yaml(path, MAX_PLAN_BYTES, "plan (YAML)", PlanError)
    with file.locating():
        return _protocol(file.path, file.data, cell)


def _protocol(path: Path, data: object, cell: Cell) -> Protocol:
    rows = data.get("configurations") if isinstance(data, dict) else None
    if not isinstance(rows, list) or not rows:
        raise PlanError(path, "configurations", quoted(rows), "a list of at least one configuration")
    configurations: list[Configuration] = []
    for i, row in enumerate(rows):
        place = f"configurations.{i}"
        if not isinstance(row, dict):
            raise PlanError(path, place, quoted(row), "a mapping with the keys number, q, steps")
        if row.get("spare") is True:
            continue
        number = row.get("number", i + 1)
        if isinstance(number, bool) or not isinstance(number, int) or number < 0:
            raise PlanError(path, f"{place}.number", quoted(number), "an integer of at least zero")
        if number in {known.number for known in configurations}:
            raise PlanError(path, f"{place}.number", f"{number} twice", "every number once")
        q = _numbers(path, f"{place}.q", row.get("q"), len(cell.robot.joints))
        steps = row.get("steps")
        if not isinstance(steps, list) or not steps:
            raise PlanError(path, f"{place}.steps", quoted(steps), "a list of at least one wrench")
        wrenches = [_numbers(path, f"{place}.steps.{k}", step, 6) for k, step in enumerate(steps)]
        configurations.append(Configuration(number, np.array(q), np.array(wrenches)))
    if not configurations:
        raise PlanError(path, "configurations", "spares only", "at least one configuration to measure")
    return Protocol(tuple(configurations))


def _numbers(path: Path, place: str, values: object, count: int) -> list[float]:
    if not isinstance(values, list) or len(values) != count:
        raise PlanError(path, place, quoted(values), f"{count} numbers")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise PlanError(path, place, quoted(value), "a finite number")
    return [float(value) for value in values]
