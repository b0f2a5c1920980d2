"""Absolute positions predicted with whole blocks of configurations left out of the fit."""

from __future__ import annotations

import numpy as np

from calibration_core.diagnosis.blocks import Blocks
from calibration_core.timeseries import Bool1D, Float1D, Float2D

LEAST_GAIN = 0.01  # of the squared error, that an effect must save on blocks left out
RIDGE = 1e-10  # of columns of length one: keeps a block that alone shows a parameter solvable


def left_out(
    columns: Float2D, residual: Float1D, partition: Blocks, used: Bool1D | None = None, ridge: Float1D | None = None
) -> Float1D:
    """Return what a linear model leaves of every coordinate when its block is left out, (3 m,).

    Args:
        columns: (3 m, p) of length about one.
        residual: (3 m,).
        partition: Of the m readings.
        used: (m,) readings that may be fitted; the others are predicted only.  None: all.
        ridge: (p,) added to the diagonal of the normal matrix; None: next to nothing.
    """
    label = np.repeat(partition.label, 3)
    fitted = np.ones(len(label), dtype=bool) if used is None else np.repeat(used, 3)
    whole, right = columns[fitted].T @ columns[fitted], columns[fitted].T @ residual[fitted]
    shrinkage = RIDGE * np.eye(len(whole)) + (0.0 if ridge is None else np.diag(ridge))
    result = np.empty_like(residual)
    for block in range(partition.count):
        rows = label == block
        own, target = columns[rows], residual[rows]
        kept = fitted[rows]
        matrix = whole - own[kept].T @ own[kept] + shrinkage
        result[rows] = target - own @ np.linalg.solve(matrix, right - own[kept].T @ target[kept])
    return result


def block_squares(error: Float1D, partition: Blocks) -> Float1D:
    """Return the sum of squares of every block, (b,)."""
    return np.asarray(np.bincount(np.repeat(partition.label, 3), error**2), dtype=np.float64)


def saves(before: Float1D, after: Float1D) -> bool:
    """Say whether an effect saves enough on blocks left out, and not on a single block only.

    Args:
        before: (b,) sums of squares without it.
        after: (b,) with it.
    """
    gain = before - after
    return bool(gain.sum() > LEAST_GAIN * before.sum() and gain.sum() - gain.max() > 0)
