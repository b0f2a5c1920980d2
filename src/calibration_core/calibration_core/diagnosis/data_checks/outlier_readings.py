"""Gross errors, judged by the extended model, so that a missing effect neither makes nor hides them."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.identification.statistics.distributions import chi2_limit
from calibration_core.identification.statistics.offsets import Rows, deleted
from calibration_core.timeseries import Float2D, Int1D

FALSE_EXCLUSION = 0.01  # probability that a clean recording loses any reading
MOST = 0.05  # never more than this share of the readings
ROUNDS = 12


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
