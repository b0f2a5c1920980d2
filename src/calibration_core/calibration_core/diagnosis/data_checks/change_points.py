"""A target or the tracker that moved part-way through a recording, found as a change point over the configurations."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.data_checks.tool_shape import Shape
from calibration_core.identification.statistics.distributions import f_tail
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings, numbers_in_time

CERTAIN = 1e-6
LEAST_TARGET, LEAST_TRACKER = 1e-4, 3e-4  # m: smaller steps are no event
RANK = 1e-9  # of the largest singular value: what depends on other columns
CONFIRMED = 1e-3  # chance that geometry leaves as much of a step that is certain without it
NOTHING_ELSE = 3.0  # times the claimed noise of a reading, that may be left of the averages
FEWEST = 6  # degrees of freedom that must be left to fit the geometry beside a step
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


@dataclasses.dataclass(frozen=True, eq=False)
class Averages:
    """What is left of every point in every configuration, r / 3 in all, and what frames and points could make of it.

    Attributes:
        target: (r,) m, mean residuals, coordinate by coordinate, base axes.
        motion: (r, 6) of the tracker.
        tools: (r, 3 p) of the points on the flange.
        owner: (r,) index of the configuration.
        count: Number of configurations.
        reading: (r / 3,) index of the first reading of each.
        centre: (3,) m, of all readings.
    """

    target: Float1D
    motion: Float2D
    tools: Float2D
    owner: Int1D
    count: int
    reading: Int1D
    centre: Float1D

    def with_step(self, step: Step) -> Float2D:
        """Return the columns of a step: the tracker's motion, or that of the point, from its configuration on."""
        moved = self.motion if step.point < 0 else self.tools[:, 3 * step.point : 3 * step.point + 3]
        return moved * (self.owner >= step.first)[:, None]


def averages(residual: Float2D, place: Float2D, axes: Float3D, readings: Readings) -> Averages:
    """Average readings: configurations count, not readings, for their geometric errors are shared.

    Args:
        residual: (m, 3) m, measured - predicted, base axes.
        place: (m, 3) m, predicted.
        axes: (m, 3, 3) rows are the flange axes in the base frame.
        readings: The same readings.
    """
    numbers = numbers_in_time(readings.configuration)
    points = np.unique(readings.point)
    rows, targets, tools, group, reading = [], [], [], [], []
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
                reading.append(int(np.flatnonzero(inside)[0]))
    return Averages(
        target=np.concatenate(targets),
        motion=np.concatenate(rows),
        tools=np.concatenate(tools),
        owner=np.repeat(group, 3),
        count=len(numbers),
        reading=np.array(reading),
        centre=place.mean(axis=0),
    )


def tracker_step(seen: Averages, geometry: Float3D, noise: float) -> Step | None:
    """Find a configuration from which on all points stand elsewhere in space; None if there is none.

    Frames and points are refitted in every test.  The geometry may be right, so that few configurations tell a step, or
    wrong by more than the step: both are tried.  Geometry takes up part of any physics that is missing, and what is
    left of that goes up and down, too: beside it a step is believed where nothing but noise is left.

    Args:
        seen: Averages of m readings.
        geometry: (m, 3, g) movement of these readings by errors of the geometry.
        noise: Claimed standard deviation of one coordinate of a reading, m.
    """
    if seen.count < 3 * EDGE + 4:
        return None
    found = _tracker_step(seen, np.hstack([seen.motion, seen.tools]))
    if found is not None and stands_beside_geometry(found, seen, geometry):
        return found
    base = _with_geometry(seen, geometry)
    found = _tracker_step(seen, base)
    if found is None:
        return None
    explained, _, _ = _fit(np.hstack([base, seen.with_step(found)]), seen.target)
    return found if float(np.sqrt(np.mean((seen.target - explained) ** 2))) < NOTHING_ELSE * noise else None


def _tracker_step(seen: Averages, base: Float2D) -> Step | None:
    """Find the step of the tracker beside columns (r, b); None where it is not certain, or too small."""
    k = seen.count
    basis = _span(base)
    target, motion = seen.target - basis @ (basis.T @ seen.target), seen.motion
    freedom = 3 * k - basis.shape[1] - motion.shape[1]
    if freedom < FEWEST:
        return None
    best: tuple[float, int] | None = None
    for first in range(EDGE, k - EDGE + 1):
        own = motion * (seen.owner >= first)[:, None]
        own = own - basis @ (basis.T @ own)
        left = float(((target - own @ np.linalg.lstsq(own, target, rcond=RANK)[0]) ** 2).sum())
        if best is None or left < best[0]:
            best = (left, first)
    assert best is not None  # noqa: S101 - k is large enough
    left, first = best
    stepped = motion * (seen.owner >= first)[:, None]
    values = _fit(np.hstack([base, stepped]), seen.target)[1][-6:]
    ratio = (float(target @ target) - left) / 6 / max(left / freedom, 1e-30)
    shift = _motion(seen.centre) @ values
    size = float(np.linalg.norm(shift))
    if f_tail(ratio, 6, freedom) * k > CERTAIN or size < LEAST_TRACKER:
        return None
    return Step(first, -1, shift, size)


def _with_geometry(seen: Averages, geometry: Float3D) -> Float2D:
    """Return frames, points and geometry, (r, b), columns of length one."""
    errors = geometry[seen.reading].reshape(len(seen.target), -1)
    base = np.hstack([seen.motion, seen.tools, errors])
    return np.asarray(base / np.maximum(np.linalg.norm(base, axis=0), 1e-300))


def _span(columns: Float2D) -> Float2D:
    """Return orthonormal columns that span columns, of which some may depend on others."""
    left, size, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return np.asarray(left[:, size > RANK * size[0]])


def stands_beside_geometry(step: Step, seen: Averages, geometry: Float3D) -> bool:
    """Say whether a step is still there where errors of the robot's geometry are fitted beside it.

    Configurations that follow each other are often near each other, and so are their geometric errors: over many of
    them these go up and down like steps.  Where the configurations are too few to fit the geometry, the step stands.

    Args:
        step: What was found without.
        seen: What it was found in.
        geometry: (m, 3, g) movement of the same m readings by errors of the geometry.
    """
    base, stepped = _with_geometry(seen, geometry), seen.with_step(step)
    fitted, _, rank = _fit(base, seen.target)
    before = float(((seen.target - fitted) ** 2).sum())
    fitted, _, with_step = _fit(np.hstack([base, stepped]), seen.target)
    left = float(((seen.target - fitted) ** 2).sum())
    added, freedom = with_step - rank, 3 * seen.count - with_step
    if freedom < FEWEST:
        return True
    return added > 0 and f_tail((before - left) / added / max(left / freedom, 1e-30), added, freedom) < CONFIRMED


def _motion(place: Float1D) -> Float2D:
    x, y, z = place
    return np.hstack([np.eye(3), np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])])


def _fit(columns: Float2D, target: Float1D) -> tuple[Float1D, Float1D, int]:
    """Return what columns explain of the target, their factors, and how many of them are independent."""
    values, _, rank, _ = np.linalg.lstsq(columns, target, rcond=RANK)
    return np.asarray(columns @ values), np.asarray(values), int(rank)
