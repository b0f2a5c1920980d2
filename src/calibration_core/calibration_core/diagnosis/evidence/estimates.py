"""Compliances and accepted effects of loaded steps together, by generalised least squares.

The covariance of the rows holds, beside their noise, the errors of instruments and geometry, what effects leave to
chance, and the small effects that were found to be there.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from calibration_core.diagnosis.evidence.design import PRIOR_WIDTH, Design
from calibration_core.estimation.likelihood.small_effects import MOST, shared_power
from calibration_core.timeseries import Float1D, Float2D

FAR = 2.0  # times the width of the prior: effects beyond it are none of the usual size
WIDENED = 3  # times, a prior is compared with the size that was found
RANK = 1e-10  # of the largest eigenvalue: directions below it are rounding errors


def estimates(design: Design, accepted: tuple[int, ...], share: Float1D | float = 0.0) -> tuple[Float1D, Float2D]:
    """Return values and covariance of null corrections and accepted parameters, in their units.

    Accepted parameters keep their (wide) priors; where an effect is far larger than these, its prior is as wide as it.

    Args:
        design: The whitened model.
        accepted: Candidates in the model.
        share: (c,) signal-to-noise ratio of every candidate's place in the covariance, or one of all.
    """
    n, gram = design.n, design.gram()
    weights = np.zeros(len(design.prior))
    if np.any(share):
        each = np.repeat(np.broadcast_to(share, len(design.blocks)), [b.stop - b.start for b in design.blocks])
        weights[: design.discrepancy.start] = np.minimum(each * _unit(design, gram), MOST / PRIOR_WIDTH)
    own = [c for i in accepted for c in range(design.blocks[i].start, design.blocks[i].stop)]
    for i in accepted:
        weights[design.chances[i]] = 1.0
    weights[design.discrepancy] = 1.0
    weights[own] = 0.0
    active = np.flatnonzero(weights)
    scaled = gram[:, n + active] * weights[active]
    lower = cholesky(np.eye(len(active)) + scaled[n + active] * weights[active][:, None], lower=True)
    half = solve_triangular(lower, scaled.T, lower=True, check_finite=False).T
    columns = [*range(n), *(n + c for c in own)]
    metric = gram[columns] - half[columns] @ half.T
    unit = np.concatenate([np.ones(n), design.prior[own]])
    counts = [design.blocks[i].stop - design.blocks[i].start for i in accepted]
    width = np.ones(len(counts))
    value, inverse = _solved(metric, columns, np.repeat(width, counts))
    for _ in range(WIDENED):
        ends = n + np.cumsum(counts)
        sizes = [np.sqrt(np.mean(value[end - k : end] ** 2)) for k, end in zip(counts, ends, strict=True)]
        if all(size <= max(one, FAR) for size, one in zip(sizes, width, strict=True)):
            break
        width = np.maximum(width, [size if size > FAR else 1.0 for size in sizes])
        value, inverse = _solved(metric, columns, np.repeat(width, counts))
    return value * unit, np.asarray(inverse * np.outer(unit, unit), dtype=np.float64)


def _solved(metric: Float2D, columns: list[int], width: Float1D) -> tuple[Float1D, Float2D]:
    """Return values (n + k,), and their covariance, of null corrections and accepted parameters with such priors."""
    n = len(columns) - len(width)
    matrix = metric[:, columns] + np.diag(np.concatenate([np.zeros(n), width**-2.0]))
    scale = np.sqrt(np.clip(np.diag(matrix), 1e-300, None))
    inverse = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    return inverse @ metric[:, -1], inverse


def _unit(design: Design, gram: Float2D) -> Float1D:
    """Return the sizes at which every place moves the points by as much as the noise, null model apart, (p,)."""
    n, own = design.n, design.discrepancy.start
    cross = gram[:n, n : n + own]
    scale = np.sqrt(np.clip(np.diag(gram)[:n], 1e-300, None))
    values, vectors = np.linalg.eigh(gram[:n, :n] / np.outer(scale, scale))
    kept = values > RANK * values[-1]
    taken = (vectors[:, kept] / np.sqrt(values[kept])).T @ (cross / scale[:, None])
    power = np.maximum(np.diag(gram)[n : n + own] - (taken**2).sum(axis=0), 0.0)
    return shared_power(power, design.candidates, design.blocks)
