"""The rows of a data set as series: per type and quantity, every robot's values over its dates."""

from __future__ import annotations

import dataclasses
import datetime as dt
from collections.abc import Iterable, Sequence

import numpy as np

from calibration_core.fleet.recordings.rows import Row
from calibration_core.policy import MAD
from calibration_core.timeseries import Float1D

DAYS = 365.25  # per year
LEAST_PAIRS = 8  # differences from which repeatability is judged
STIFFNESS = "stiffness"


@dataclasses.dataclass(frozen=True, eq=False)
class Series:
    """One quantity of one robot over its dates.

    Attributes:
        years: (d,) dates in the order of time, years.
        value: (d,) ln(N*m/rad) of a stiffness, rad of a backlash or hysteresis.
        std: (d,) standard deviations.
    """

    robot: str
    years: Float1D
    value: Float1D
    std: Float1D


@dataclasses.dataclass(frozen=True, eq=False)
class Quantity:
    """One quantity of all robots of a type.

    Attributes:
        kind: `stiffness`, `backlash` or `hysteresis`.
        series: One per robot that has it, by name of the robot.
        repeatability: Factor on the stated standard deviations that the scatter between dates asks for, at least 1.
    """

    type: str
    kind: str
    joint: str
    series: tuple[Series, ...]
    repeatability: float

    @property
    def name(self) -> str:
        """For example `stiffness.joint_2`."""
        return f"{self.kind}.{self.joint}"


def quantities(rows: Iterable[Row]) -> tuple[Quantity, ...]:
    """Return every quantity of every type, sorted; rows without a usable result are passed over."""
    found: dict[tuple[str, str, str], dict[str, list[tuple[float, float, float]]]] = {}
    for row in sorted(rows, key=lambda row: (row.date, row.recording)):
        if not row.measured or row.usable == "no":
            continue
        year = dt.date.fromisoformat(row.date).toordinal() / DAYS
        for kind, joint, value, std in _values(row):
            if np.isfinite(value) and np.isfinite(std) and std > 0:
                robots = found.setdefault((row.type, kind, joint), {})
                robots.setdefault(row.robot, []).append((year, value, std))
    return tuple(_quantity(*name, robots) for name, robots in sorted(found.items()))


def _values(row: Row) -> Sequence[tuple[str, str, float, float]]:
    logs, stds = row.log_stiffness
    values = [(STIFFNESS, joint, float(y), float(s)) for joint, y, s in zip(row.joints, logs, stds, strict=True)]
    for name, value, std in zip(row.law_names, row.law_values, row.law_stds, strict=True):
        kind, _, joint = name.partition(".")
        values.append((kind, joint, value, std))
    return values


def _quantity(
    kind_of_robot: str, kind: str, joint: str, robots: dict[str, list[tuple[float, float, float]]]
) -> Quantity:
    series = [Series(robot, *np.array(values).T) for robot, values in sorted(robots.items())]
    factor = repeatability(series)
    scaled = tuple(dataclasses.replace(one, std=factor * one.std) for one in series)
    return Quantity(kind_of_robot, kind, joint, scaled, factor)


def repeatability(series: Sequence[Series]) -> float:
    """Return the factor on the stated standard deviations that the scatter between dates asks for, at least 1.

    From the median of all differences between one date and the next, which the few robots that changed do not move.
    """
    pairs = [
        (one.value[1:] - one.value[:-1]) / np.hypot(one.std[1:], one.std[:-1]) for one in series if len(one.value) > 1
    ]
    ratios = np.concatenate([np.zeros(0), *pairs])
    if len(ratios) < LEAST_PAIRS:
        return 1.0
    return max(1.0, MAD * float(np.median(np.abs(ratios - np.median(ratios)))))
