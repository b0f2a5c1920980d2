"""Gross errors, judged by the extended model, so that a missing effect neither makes nor hides them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration_core.identification.statistics.distributions import chi2_limit
from calibration_core.identification.statistics.offsets import Rows, deleted, deletion_limit
from calibration_core.identification.stiffness.outlier_rejection import worst_of_each
from calibration_core.timeseries import Float2D, Float3D, Int1D, Readings

MOST = 0.05  # never more than this share of the readings
ROUNDS = 12
SHAPE = 3  # points, of which the shape is known
OUT_OF_SHAPE = 0.01  # probability that noise alone changes the shape of any step of a recording more


def readings_to_use(rows: Rows, residual: Float2D, step: Int1D) -> Int1D:
    """Return the indices of the readings that are no gross errors.

    Every reading is predicted from the others of its configuration and the model; the worst of every configuration
    and point goes first, and the others are judged again without it.

    Args:
        rows: Grouping and noise of all m readings.
        residual: (m, 3) m, measured - model.
        step: (m,) number of each reading's step.
    """
    m = len(residual)
    used, some = np.arange(m), rows
    for _ in range(ROUNDS):
        squared, _, _ = deleted(some, residual[used])
        groups = np.column_stack([some.configuration, some.offset])
        room = int(MOST * m) - (m - len(used))
        worst = worst_of_each(squared, deletion_limit(squared, m), groups, step[used])[: max(room, 0)]
        if not len(worst):
            break
        used, some = np.delete(used, worst), some.without(worst)
    return used


def whole_steps(
    readings: Readings, place: Float2D, residual: Float2D, noise: Float3D, used: Int1D, sound: Int1D
) -> Int1D:
    """Return the readings of steps that were set aside whole, although the tool kept its shape.

    A tracker errs at one point or another; where all points of a step moved as one rigid body, the robot did, or the
    load was another.

    Args:
        readings: All m readings.
        place: (m, 3) m, where their points are, in the axes of the residuals.
        residual: (m, 3) m, measured - model.
        noise: (m, 3, 3) m^2, covariance that each reading has of its own.
        used: Indices of those that are no gross errors.
        sound: Indices of those that may be used at all.
    """
    aside = np.setdiff1d(sound, used)
    found = [
        rows
        for rows in _steps_of(readings, aside, sound)
        if len(rows) >= SHAPE
        and np.isin(rows, aside).all()
        and _moved_rigidly(readings, place, residual, noise, used, rows)
    ]
    return np.concatenate([np.zeros(0, dtype=np.int64), *found])


def moved_with_their_step(
    readings: Readings, place: Float2D, residual: Float2D, noise: Float3D, used: Int1D, aside: Int1D
) -> Int1D:
    """Return those of the readings set aside whose step moved as one rigid body: no gross errors of a tracker.

    An error at one of three points across their plane is a turn of all of them.  So the others must have moved, too.

    Args:
        readings: All m readings.
        place: (m, 3) m, where their points are, in the axes of the residuals.
        residual: (m, 3) m, measured - model.
        noise: (m, 3, 3) m^2, covariance that each reading has of its own.
        used: Indices of those that are no gross errors.
        aside: Indices of those set aside.
    """
    found = [np.zeros(0, dtype=np.int64)]
    for rows in _steps_of(readings, aside, np.union1d(used, aside)):
        elsewhere = np.setdiff1d(used, rows)
        if (
            len(rows) >= SHAPE
            and _moved(readings, residual, noise, elsewhere, np.setdiff1d(rows, aside))
            and _moved_rigidly(readings, place, residual, noise, elsewhere, rows)
        ):
            found.append(np.intersect1d(rows, aside))
    return np.concatenate(found)


def _steps_of(readings: Readings, some: Int1D, among: Int1D) -> Iterator[Int1D]:
    """Yield for each step that some readings are of all its readings among others, as indices."""
    keys = np.column_stack([readings.configuration, readings.step])
    for key in np.unique(keys[some], axis=0):
        yield among[(keys[among] == key).all(axis=1)]


def _moved(readings: Readings, residual: Float2D, noise: Float3D, used: Int1D, rows: Int1D) -> bool:
    """Say whether readings of one step, none of them gross by itself, moved by more than noise; of no readings: yes."""
    if not len(rows):
        return True
    against = _against_others(readings, residual, noise, used, rows)
    if against is None:
        return False
    moved, variance = against
    return bool((moved**2).sum() > variance * chi2_limit(OUT_OF_SHAPE / len(residual), moved.size))


def _against_others(
    readings: Readings, residual: Float2D, noise: Float3D, used: Int1D, rows: Int1D
) -> tuple[Float2D, float] | None:
    """Return how far readings of a step moved against used steps of their configuration, (k, 3) m, and its variance.

    None where a point was read at no other step.
    """
    same = readings.configuration[used] == readings.configuration[rows[0]]
    others = [used[same & (readings.point[used] == readings.point[row])] for row in rows]
    if not all(len(each) for each in others):
        return None
    moved = residual[rows] - np.stack([residual[each].mean(axis=0) for each in others])
    variance = float(np.mean(np.trace(noise[rows], axis1=1, axis2=2))) / 3
    return moved, variance * (1 + float(np.mean([1 / len(each) for each in others])))


def _moved_rigidly(
    readings: Readings, place: Float2D, residual: Float2D, noise: Float3D, used: Int1D, rows: Int1D
) -> bool:
    """Say whether the points of a step moved as a rigid body against the used steps of their configuration."""
    against = _against_others(readings, residual, noise, used, rows)
    if against is None:
        return False
    moved, variance = against
    lever = place[rows] - place[rows].mean(axis=0)
    turns = np.cross(np.eye(3)[None], lever[:, None, :])  # (k, 3, 3): turn about every axis, what it moves
    rigid = np.concatenate([np.tile(np.eye(3), (len(rows), 1)), turns.transpose(0, 2, 1).reshape(-1, 3)], axis=1)
    motion, _, rank, _ = np.linalg.lstsq(rigid, moved.reshape(-1), rcond=1e-6)
    left = moved.reshape(-1) - rigid @ motion
    return bool(left @ left < variance * chi2_limit(OUT_OF_SHAPE / len(residual), len(left) - int(rank)))
