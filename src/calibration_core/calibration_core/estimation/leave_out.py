"""Rows predicted with whole blocks of configurations left out; accepted columns keep the prior of their size."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from calibration_core.estimation.blocks import Blocks
from calibration_core.timeseries import Bool1D, Float1D, Float2D

RIDGE = 1e-10  # of columns of length one: keeps a block that alone shows a parameter solvable
LEAST_NATS = 3.0  # that a hypothesis must gain on blocks left out


def left_out(
    columns: Float2D,
    residual: Float1D,
    partition: Blocks,
    ridge: Float1D,
    used: Bool1D | None = None,
    own: tuple[Float2D, Float1D] | None = None,
) -> Float1D:
    """Return what a linear model leaves of every row when its block is left out, (3 m,).

    Args:
        columns: (3 m, p) of length about one.
        residual: (3 m,).
        partition: Of the m readings.
        ridge: (p,) prior precision times the noise variance.
        used: (m,) readings that may be fitted; the others are predicted only.  None: all.
        own: The same columns and residual in other units, in which the answer is wanted; None: as fitted.
    """
    shown, target_of = (columns, residual) if own is None else own
    label = np.repeat(partition.label, 3)
    fitted = np.ones(len(label), dtype=bool) if used is None else np.repeat(used, 3)
    whole, right = columns[fitted].T @ columns[fitted], columns[fitted].T @ residual[fitted]
    shrinkage = np.diag(RIDGE + ridge)
    result = np.empty_like(residual)
    for block in range(partition.count):
        rows = label == block
        kept = rows & fitted
        there, target = columns[kept], residual[kept]
        solved = np.linalg.solve(whole - there.T @ there + shrinkage, right - there.T @ target)
        result[rows] = target_of[rows] - shown[rows] @ solved
    return result


def left_out_blocks(columns: Float2D, residual: Float1D, partitions: Sequence[Blocks], ridge: Float1D) -> list[Float1D]:
    """Return the same for several partitions, all rows fitted, from the part of the hat matrix of every block.

    e_b = (I - H_bb)^(-1) r_b with H = X (X'X + R)^(-1) X': one factorisation serves all blocks.
    """
    lower = cholesky(columns.T @ columns + np.diag(RIDGE + ridge), lower=True, overwrite_a=True)
    half = solve_triangular(lower, columns.T, lower=True)  # (p, r)
    fitted = residual - (half @ residual) @ half
    answers = []
    for partition in partitions:
        label = np.repeat(partition.label, 3)
        result = np.zeros_like(residual)  # rows beyond the readings are priors, which stay
        for block in range(partition.count):
            rows = np.flatnonzero(label == block)
            own = half[:, rows]
            result[rows] = np.linalg.solve(np.eye(len(rows)) - own.T @ own, fitted[rows])
        answers.append(result)
    return answers


def block_squares(error: Float1D, partition: Blocks) -> Float1D:
    """Return the sum of squares of every block, (b,)."""
    return np.asarray(
        np.bincount(np.repeat(partition.label, 3), error[: 3 * len(partition.label)] ** 2), dtype=np.float64
    )


@dataclasses.dataclass(frozen=True)
class Proof:
    """What blocks left out say of a hypothesis.

    Attributes:
        nats: Squares saved over twice the variance.
        without_best: The same without the block that saves most.
        share: Of the squares, that is saved.
    """

    nats: float
    without_best: float
    share: float

    @property
    def holds(self) -> bool:
        """Whether enough is saved, and not on a single block only."""
        return self.nats > LEAST_NATS and self.without_best > 0


def proof(before: Float1D, after: Float1D, variance: float) -> Proof:
    """Compare squares per block, (b,), without and with a hypothesis."""
    gain = (before - after) / (2 * variance)
    return Proof(float(gain.sum()), float(gain.sum() - gain.max()), float((before - after).sum() / before.sum()))
