"""Rows predicted with whole blocks of configurations left out; accepted columns keep the prior of their size."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtri

from calibration_core.estimation.blocks import STAYS, Blocks
from calibration_core.estimation.columns import Columns, rows_of_readings
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

RIDGE = 1e-10  # of columns of length one: keeps a block that alone shows a parameter solvable
FEW = 48  # columns: more are not added to a factorisation, they get their own
NOTHING = np.zeros(0)
LEAST_NATS = 3.0  # that a hypothesis must gain on blocks left out


def left_out(
    columns: Columns,
    residual: Float1D,
    partition: Blocks,
    normal: tuple[Float2D, Float1D],
    used: Bool1D | None = None,
    own: tuple[Columns, Float1D] | None = None,
    fixed: Float2D | None = None,
) -> Float1D:
    """Return what a linear model leaves of every row when its block is left out, (3 m,).

    Args:
        columns: Of m readings, p.
        residual: (3 m,).
        partition: Of the readings, all of which are in a block.
        normal: (p, p) and (p,), the normal equations of all rows that are fitted, priors included.
        used: (m,) readings that may be fitted; the others are predicted only.  None: all.
        own: The same columns and residual in other units, in which the answer is wanted; None: as fitted.
        fixed: (h, p) combinations of the parameters that stay zero; None: none.
    """
    (whole, right), result = normal, np.full((len(partition.label), 3), np.nan)
    for block in range(partition.count):
        rows = partition.readings(block)
        there, seen = columns.rows(rows), rows_of_readings(residual, rows)
        kept = slice(None) if used is None or used[rows].all() else np.flatnonzero(used[rows])
        fitted = there.rows(kept)
        without, shown = whole - fitted.products(), right - fitted.against(rows_of_readings(seen, kept))
        factor = cho_factor(without, lower=True, overwrite_a=True, check_finite=False)
        solved = cho_solve(factor, shown, check_finite=False)
        if fixed is not None and len(fixed):
            held = cho_solve(factor, fixed.T)
            solved -= held @ np.linalg.solve(fixed @ held, fixed @ solved)
        if own is not None:
            there, seen = own[0].rows(rows), rows_of_readings(own[1], rows)
        result[rows] = (seen - there.moved(solved)).reshape(-1, 3)
    return result.reshape(-1)


@dataclasses.dataclass(frozen=True, eq=False)
class _Block:
    """(I - H_bb)^(-1) of a block of b rows, H_bb = K'K with K (p, b), by a factor of the smaller size.

    (I - K'K)^(-1) = I + K' (I - K K')^(-1) K, and both determinants are the same (Woodbury; Sylvester).

    Attributes:
        rows: (b,) indices of the rows.
        factor: Cholesky factor of I - K'K, (b, b), or of I - K K', (p, p).
        through: (p, b) K; None: the factor is (b, b).
    """

    rows: Int1D
    factor: Float2D
    through: Float2D | None

    @staticmethod
    def of(rows: Int1D, through: Float2D) -> _Block:
        """Factorise a block, of which K is given, (p, b)."""
        p, b = through.shape
        if b <= p:
            return _Block(rows, _factor(np.eye(b) - through.T @ through), None)
        return _Block(rows, _factor(np.eye(p) - through @ through.T), through)

    def solve(self, right: Float2D) -> Float2D:
        """Return (I - H_bb)^(-1) times some columns, (b, c)."""
        if self.through is None:
            return np.asarray(dpotrs(self.factor, right, lower=True)[0])
        return np.asarray(right + self.through.T @ dpotrs(self.factor, self.through @ right, lower=True)[0])

    @property
    def log_determinant(self) -> float:
        """Log |I - H_bb|."""
        return 2 * float(np.log(np.diag(self.factor)).sum())

    def beside(self, left: Float1D, more: Float2D) -> tuple[Float1D, float]:
        """Return what is left of the rows when they are left out, (b,), and log |I - H_bb|, with further columns.

        Args:
            left: (b,) what the whole model, further columns included, leaves of them.
            more: (k, b) what k further columns add to H.
        """
        solved = self.solve(np.column_stack([left, more.T]))
        plain, through = solved[:, 0], solved[:, 1:]
        inner = np.eye(len(more)) - more @ through
        error = plain + through @ np.linalg.solve(inner, more @ plain)
        return error, self.log_determinant + float(np.linalg.slogdet(inner)[1])


class LeftOut:
    """A linear model with every block of several partitions left out, and what more columns would change.

    e_b = (I - H_bb)^(-1) r_b with H = X (X'X + R)^(-1) X': one factorisation serves all blocks.  Further columns Z add
    U'U to H, U = S^(-1/2) (Z - H Z)' with S = Z' (Z - H Z) + R_z, so that they cost little (Woodbury).  Where X'X is
    known already, it is given as `products`, (p, p).

    Attributes:
        partitions: Of the readings; rows beyond them are priors, which stay.
        residual: (r,).
        columns: (r, p) of length about one.
        ridge: (p,) prior precision times the noise variance.
        products: (p, p) of the columns.
        half: (p, r) (X'X + R)^(-1/2) X'.
        left: (r,) what the model leaves, nothing left out.
        blocks: Per partition.
    """

    def __init__(
        self,
        columns: Float2D,
        residual: Float1D,
        partitions: Sequence[Blocks],
        ridge: Float1D,
        products: Float2D | None = None,
    ) -> None:
        self.products = columns.T @ columns if products is None else products
        self.partitions, self.residual = tuple(partitions), residual
        self.columns, self.ridge = columns, ridge
        normal = self.products.copy()
        normal[np.diag_indices_from(normal)] += RIDGE + ridge
        lower = cholesky(normal, lower=True, overwrite_a=True, check_finite=False)
        root, _ = dtrtri(lower, lower=True, overwrite_c=True)  # the inverse: a product with it is quicker than solving
        self.half = np.asarray(dtrmm(1.0, root, columns.T, lower=1), dtype=np.float64)
        self.left = residual - (self.half @ residual) @ self.half
        self.blocks: list[list[_Block]] = []
        for partition in self.partitions:
            label = np.repeat(partition.label, 3)
            rows = [np.flatnonzero(label == block) for block in range(partition.count)]
            self.blocks.append([_Block.of(own, self.half[:, own]) for own in rows])

    @property
    def errors(self) -> list[Float1D]:
        """Per partition what is left of every row when its block is left out, (r,)."""
        answers = []
        for several in self.blocks:
            result = np.zeros_like(self.residual)
            for block in several:
                result[block.rows] = block.solve(self.left[block.rows, None])[:, 0]
            answers.append(result)
        return answers

    def beside(self, columns: Float2D, ridge: Float1D) -> list[Float1D]:
        """Return the same with k further columns (r, k), of prior precision (k,) times the noise variance."""
        if columns.shape[1] > FEW:
            return self._with(columns, ridge).errors
        more, left = self._more(columns, ridge)
        answers = []
        for several in self.blocks:
            result = np.zeros_like(self.residual)
            for block in several:
                result[block.rows], _ = block.beside(left[block.rows], more[:, block.rows])
            answers.append(result)
        return answers

    def scores(self, variance: float, columns: Float2D | None = None, ridge: Float1D = NOTHING) -> list[Float1D]:
        """Return per partition and block, (b,), -2 v log density of its rows given all others, up to a constant.

        With v the variance of the noise the rows of a block given the others have covariance v (I - H_bb)^(-1).

        Args:
            variance: v.
            columns: (r, k) further columns; None: none.
            ridge: (k,) their prior precision times the noise variance.
        """
        if columns is not None and columns.shape[1] > FEW:
            return self._with(columns, ridge).scores(variance)
        more, left = (np.zeros((0, len(self.residual))), self.left) if columns is None else self._more(columns, ridge)
        answers = []
        for several in self.blocks:
            scores = []
            for block in several:
                error, log_determinant = block.beside(left[block.rows], more[:, block.rows])
                scores.append(float(left[block.rows] @ error) - variance * log_determinant)
            answers.append(np.array(scores))
        return answers

    def _with(self, columns: Float2D, ridge: Float1D) -> LeftOut:
        both, precision = np.concatenate([self.columns, columns], axis=1), np.concatenate([self.ridge, ridge])
        across, own = self.columns.T @ columns, columns.T @ columns
        return LeftOut(
            both, self.residual, self.partitions, precision, np.block([[self.products, across], [across.T, own]])
        )

    def _more(self, columns: Float2D, ridge: Float1D) -> tuple[Float2D, Float1D]:
        """Return what further columns add to `half`, (k, r), and what is left beside them, (r,)."""
        rest = columns - self.half.T @ (self.half @ columns)
        lower = cholesky(columns.T @ rest + np.diag(RIDGE + ridge), lower=True)
        more = solve_triangular(lower, rest.T, lower=True)
        return more, self.left - (more @ self.residual) @ more


def _factor(matrix: Float2D) -> Float2D:
    """Return the Cholesky factor; what a block alone shows is zero but for rounding, and becomes the ridge."""
    factor, failed = dpotrf(matrix, lower=True)
    if failed:
        own, turn = np.linalg.eigh(matrix)
        factor, _ = dpotrf((turn * np.maximum(own, RIDGE)) @ turn.T, lower=True)
    return np.asarray(factor, dtype=np.float64)


def block_squares(error: Float1D, partition: Blocks) -> Float1D:
    """Return the sum of squares of every block, (b,)."""
    left_out = np.repeat(partition.label, 3) != STAYS
    squares = error[: len(left_out)][left_out] ** 2
    return np.asarray(np.bincount(np.repeat(partition.label, 3)[left_out], squares), dtype=np.float64)


@dataclasses.dataclass(frozen=True)
class Proof:
    """What blocks left out say of a hypothesis.

    Attributes:
        nats: Squares saved over twice the variance.
        without_best: The same without the block that saves most.
        share: Of the squares, that is saved; of densities it means nothing.
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
