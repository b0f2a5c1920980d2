"""A target or the tracker that moved part-way through a recording, found as a change point over the configurations."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.data_checks.tool_shape import Shape
from calibration_core.identification.statistics.distributions import f_tail
from calibration_core.timeseries import Float1D, Float2D, Float3D, Readings

CERTAIN = 1e-6
LEAST_TARGET, LEAST_TRACKER = 1e-4, 3e-4  # m: smaller steps are no event
EDGE = 2  # configurations on either side of a change, at least


@dataclasses.dataclass(frozen=True, eq=False)
class Step:
    """A change between two configurations.

    Attributes:
        first: Index of the first configuration after it.
        point: Which point moved; -1: all of them.
        shift: (3,) m, after minus before.
        size: m.
    """

    first: int
    point: int
    shift: Float1D
    size: float


def target_step(shape: Shape) -> Step | None:
    """Find the point that stands elsewhere against the others from one configuration on; None if none does."""
    means = np.nanmean(shape.against_others(), axis=1)
    best: tuple[float, int, int] | None = None
    for point in range(shape.points):
        series = means[:, point]
        good = np.isfinite(series).all(axis=1)
        for first in range(EDGE, len(series) - EDGE + 1):
            explained, chance = _step_chance(series, good, first)
            if chance * shape.points * len(series) < CERTAIN and (best is None or explained > best[0]):
                best = (explained, point, first)
    if best is None:
        return None
    _, point, first = best
    series = means[:, point]
    shift = np.nanmean(series[first:], axis=0) - np.nanmean(series[:first], axis=0)
    size = float(np.linalg.norm(shift))
    return Step(first, point, shift, size) if size > LEAST_TARGET else None


def _step_chance(series: Float2D, good: np.ndarray, first: int) -> tuple[float, float]:
    """Return the sum of squares that a step explains, and the chance of so much (F test), from (k, 3)."""
    before, after = series[:first][good[:first]], series[first:][good[first:]]
    if len(before) < EDGE or len(after) < EDGE:
        return 0.0, 1.0
    within = float(((before - before.mean(axis=0)) ** 2).sum() + ((after - after.mean(axis=0)) ** 2).sum())
    difference = after.mean(axis=0) - before.mean(axis=0)
    explained = float(difference @ difference) * len(before) * len(after) / (len(before) + len(after))
    freedom = 3 * (len(before) + len(after) - 2)
    return explained, f_tail(explained / 3 / max(within / freedom, 1e-30), 3, freedom)


def tracker_step(residual: Float2D, place: Float2D, axes: Float3D, readings: Readings) -> Step | None:
    """Find a configuration from which on all points stand elsewhere in space; None if there is none.

    Frames and points are refitted in every test; configurations count, not readings, for their geometric errors are
    shared.

    Args:
        residual: (m, 3) m, measured - predicted, base axes.
        place: (m, 3) m, predicted.
        axes: (m, 3, 3) rows are the flange axes in the base frame.
        readings: The same readings.
    """
    _, order = np.unique(readings.configuration, return_index=True)
    numbers = readings.configuration[np.sort(order)]
    k = len(numbers)
    points = np.unique(readings.point)
    if k < 3 * EDGE + 4:
        return None
    rows, targets, tools, group = [], [], [], []
    for index, number in enumerate(numbers):
        for column, point in enumerate(points):
            inside = (readings.configuration == number) & (readings.point == point)
            if inside.any():
                targets.append(residual[inside].mean(axis=0))
                rows.append(_motion(place[inside].mean(axis=0)))
                tool = np.zeros((3, 3 * len(points)))
                tool[:, 3 * column : 3 * column + 3] = axes[inside][0].T
                tools.append(tool)
                group.append(index)
    motion, tool_columns, target = np.concatenate(rows), np.concatenate(tools), np.concatenate(targets)
    owner = np.repeat(group, 3)
    base = np.hstack([motion, tool_columns])
    without = _rest(base, target)
    best: tuple[float, int, Float1D] | None = None
    for first in range(EDGE, k - EDGE + 1):
        stepped = motion * (owner >= first)[:, None]
        basis, values = _fit(np.hstack([base, stepped]), target)
        left = float(((target - basis) ** 2).sum())
        if best is None or left < best[0]:
            best = (left, first, values[-6:])
    assert best is not None  # noqa: S101 - k is large enough
    left, first, values = best
    freedom = 3 * k - 12
    ratio = (without - left) / 6 / max(left / freedom, 1e-30)
    centre = place.mean(axis=0)
    shift = _motion(centre) @ values
    size = float(np.linalg.norm(shift))
    if f_tail(ratio, 6, freedom) * k > CERTAIN or size < LEAST_TRACKER:
        return None
    return Step(first, -1, shift, size)


def _motion(place: Float1D) -> Float2D:
    x, y, z = place
    return np.hstack([np.eye(3), np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])])


def _fit(columns: Float2D, target: Float1D) -> tuple[Float1D, Float1D]:
    values = np.linalg.lstsq(columns, target, rcond=1e-9)[0]
    return np.asarray(columns @ values), np.asarray(values)


def _rest(columns: Float2D, target: Float1D) -> float:
    return float(((target - _fit(columns, target)[0]) ** 2).sum())
