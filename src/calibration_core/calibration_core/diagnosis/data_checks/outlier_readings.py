"""Gross errors, judged by the extended model, so that a missing effect neither makes nor hides them."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.identification.statistics.distributions import chi2_limit
from calibration_core.identification.statistics.offsets import Rows, deleted
from calibration_core.timeseries import Float2D, Int1D, Readings

FALSE_EXCLUSION = 0.01  # probability that a clean recording loses any reading
MOST = 0.05  # never more than this share of the readings
ROUNDS = 12
BY_CHANCE = 0.01  # expected number of steps of which gross errors hit every point


def readings_to_use(rows: Rows, residual: Float2D) -> Int1D:
    """Return the indices of the readings that are no gross errors.

    Every reading is predicted from the others of its configuration and the model; the worst of every configuration
    and point goes first, and the others are judged again without it.

    Args:
        rows: Grouping and noise of all m readings.
        residual: (m, 3) m, measured - model.
    """
    m = len(residual)
    used = np.arange(m)
    for _ in range(ROUNDS):
        some = rows.select(used)
        some = dataclasses.replace(some, configuration=np.unique(some.configuration, return_inverse=True)[1])
        squared, _, _ = deleted(some, residual[used])
        testable = squared > 0
        scale = float(np.median(squared[testable]) / chi2_limit(0.5, 3)) if testable.any() else 1.0
        limit = chi2_limit(FALSE_EXCLUSION / m, 3) * max(1.0, scale)
        suspects = np.flatnonzero(squared > limit)
        if not len(suspects):
            break
        order = suspects[np.argsort(-squared[suspects], kind="stable")]
        groups = np.column_stack([some.configuration, some.offset])[order]
        _, first = np.unique(groups, axis=0, return_index=True)
        room = int(MOST * m) - (m - len(used))
        worst = order[np.sort(first)][: max(room, 0)]
        if not len(worst):
            break
        used = np.delete(used, worst)
    return used


def with_whole_steps(readings: Readings, used: Int1D, sound: Int1D) -> Int1D:
    """Return the readings to use, and with them the steps of which every point was set aside.

    A tracker errs at one point or another; where all points of a step are elsewhere, the robot was, or the load.

    Args:
        readings: All readings.
        used: Indices of those that are no gross errors.
        sound: Indices of those that may be used at all.
    """
    keys = np.column_stack([readings.configuration, readings.step])[sound]
    _, step = np.unique(keys, axis=0, return_inverse=True)
    step = step.reshape(-1)
    aside = ~np.isin(sound, used)
    points, left = np.bincount(step), np.bincount(step, ~aside)
    whole = left == 0
    single = max(1, int(aside[~whole[step]].sum())) / len(sound)
    back = whole & (points >= 2) & (len(points) * single**points < BY_CHANCE)
    return np.asarray(sound[~aside | back[step]])
