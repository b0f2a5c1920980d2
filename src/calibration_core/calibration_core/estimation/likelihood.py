"""Restricted likelihood of sizes: how much data ask for each block of columns, beside everything accepted.

With the null model's flat columns projected out,  y = sum_k A_k b_k + e,  b_k ~ N(0, t_k^2 I) in typical sizes and
e ~ N(0, v I), everything after one pass over the rows works on G = A'A and A'y:

    log|V| = (n - p) log v + log|L|,   L = v I + D^(1/2) G D^(1/2),
    d/d log t_k^2 = 1/2 sum((mean^2 + variance)/t_k^2 - 1) over the block.

What one more block of size t gains beside what is accepted is exact and closed form: with g = A_k' V^-1 A_k =
U diag(l) U' and w = A_k' V^-1 y,  1/2 sum((U'w)^2 t^2/(1 + t^2 l) - log(1 + t^2 l)), maximised over t.  Sizes beyond
what the catalogue calls typical pay for it.
Source: Patterson and Thompson 1971 (restricted likelihood); MacKay 1992 (shared sizes).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize

from calibration_core.timeseries import Float1D, Float2D, Int1D

USUAL = 3.0  # typical sizes up to which nothing is paid
DEAR = 0.7  # standard deviation of the logarithm beyond
LEAST, MOST = 1e-3, 60.0  # sizes that are tried, typical
GRID = np.exp(np.linspace(np.log(LEAST), np.log(MOST), 36))
ITERATIONS = 60
SHOWN = 1e-7  # of the largest eigenvalue: directions below it are rounding errors
BATCH = 100  # blocks at a time
JITTER = 1e-9  # of the diagonal: what projecting out loses in digits


@dataclasses.dataclass(frozen=True, eq=False)
class Gram:
    """The rows condensed, flat columns projected out.

    Attributes:
        matrix: (p, p) A'A, columns per typical size.
        vector: (p,) A'y.
        square: y'y.
        freedom: Rows less flat columns.
    """

    matrix: Float2D
    vector: Float1D
    square: float
    freedom: int


@dataclasses.dataclass(frozen=True, eq=False)
class Sizes:
    """The optimum for some blocks.

    Attributes:
        variance: v, in units of the claimed noise.
        size: (k,) t of every block, typical sizes.
        value: Log likelihood, nats, up to a constant of the rows.
    """

    variance: float
    size: Float1D
    value: float


def price(size: Float1D) -> Float1D:
    """Return what sizes in typical ones cost, nats."""
    return np.asarray(0.5 * (np.log(np.maximum(size / USUAL, 1.0)) / DEAR) ** 2)


SQUARED, PRICE = GRID**2, price(GRID)


def fit_sizes(gram: Gram, blocks: Sequence[Int1D], start: Sizes | None = None) -> Sizes:
    """Maximise the restricted likelihood over the noise and one size per block.

    Args:
        gram: The rows.
        blocks: Columns of every block; no column in two.
        start: Where to begin; None: anywhere.
    """
    if not blocks:
        variance = gram.square / gram.freedom
        return Sizes(variance, np.zeros(0), -0.5 * gram.freedom * (np.log(variance) + 1))
    members = np.concatenate(blocks)
    group = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
    matrix, vector = gram.matrix[np.ix_(members, members)], gram.vector[members]
    p, unit = len(members), np.eye(len(members))
    matrix = matrix + JITTER * np.diag(np.diag(matrix))

    def negative(x: Float1D) -> tuple[float, Float1D]:
        variance, size = np.exp(x[0]), np.exp(x[1:])
        d = size[group]
        lower, inverse = _factor(variance * unit + d[:, None] * matrix * d)
        mean = d * (inverse @ (d * vector))
        spread = variance * d[:, None] * inverse * d
        misfit = (gram.square - vector @ mean) / variance
        over = np.log(np.maximum(size / USUAL, 1.0))
        value = 0.5 * ((gram.freedom - p) * x[0] + 2 * np.log(lower).sum() + misfit) + price(size).sum()
        slope = np.bincount(group, (mean**2 + np.diag(spread)) / d**2 - 1, minlength=len(blocks)) - over / DEAR**2
        left = gram.square - 2 * mean @ vector + mean @ matrix @ mean + (matrix * spread).sum()
        return float(value), -np.concatenate([[0.5 * (left / variance - gram.freedom)], slope])

    variance = gram.square / gram.freedom if start is None else start.variance
    sizes = np.full(len(blocks), 0.3) if start is None else start.size
    begin = np.concatenate([[np.log(variance)], np.log(sizes)])
    bounds = [(begin[0] - 12, begin[0] + 5)] + [(np.log(LEAST), np.log(MOST))] * len(blocks)
    options = {"maxiter": ITERATIONS, "ftol": 1e-8}
    best = minimize(negative, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return Sizes(float(np.exp(best.x[0])), np.exp(best.x[1:]), -float(best.fun))


def _factor(matrix: Float2D) -> tuple[Float1D, Float2D]:
    """Return the diagonal of the Cholesky factor of a positive matrix, and the inverse."""
    lower = cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)
    inverse, _ = dpotri(lower, lower=True)
    full = np.tril(inverse)
    return np.diag(lower), full + np.tril(full, -1).T


def beside(gram: Gram, blocks: Sequence[Int1D], sizes: Sizes) -> tuple[Float2D, Float1D]:
    """Return A' V^-1 A (p, p) and A' V^-1 y (p,), V holding the noise and the accepted blocks at their sizes."""
    if not blocks:
        return gram.matrix / sizes.variance, gram.vector / sizes.variance
    members = np.concatenate(blocks)
    d = np.repeat(sizes.size, [len(block) for block in blocks])
    half = gram.matrix[:, members] * d
    inner = sizes.variance * np.eye(len(d)) + d[:, None] * gram.matrix[np.ix_(members, members)] * d
    lower = cholesky(inner, lower=True)
    seen = solve_triangular(lower, half.T, lower=True)  # (a, p)
    right = solve_triangular(lower, d * gram.vector[members], lower=True)
    return (gram.matrix - seen.T @ seen) / sizes.variance, (gram.vector - seen.T @ right) / sizes.variance


def gains(matrix: Float2D, vectors: Float2D, blocks: Sequence[Int1D]) -> tuple[Float2D, Float2D]:
    """Return what every block gains at its best size, nats, and that size, (h, s) each.

    Args:
        matrix: (p, p) A' V^-1 A.
        vectors: (p, s) A' V^-1 y of one or several data.
        blocks: Columns of the h blocks.
    """
    value, best = np.zeros((len(blocks), vectors.shape[1])), np.zeros((len(blocks), vectors.shape[1]))
    count = np.array([len(block) for block in blocks])
    for k in np.unique(count):
        chosen = np.flatnonzero(count == k)
        index = np.stack([blocks[int(h)] for h in chosen])
        own, turn = np.linalg.eigh(matrix[index[:, :, None], index[:, None, :]])
        shown = own > SHOWN * own[:, -1:]
        own = np.where(shown, own, 0.0)
        seen = (turn.transpose(0, 2, 1) @ vectors[index]) ** 2 * shown[:, :, None]  # (c, k, s)
        wide = 1.0 + SQUARED[:, None, None] * own  # (g, c, k)
        lost = 0.5 * np.log(wide).sum(axis=2) + PRICE[:, None]
        for part in range(0, len(chosen), BATCH):
            some = slice(part, part + BATCH)
            weight = (SQUARED[:, None, None] / wide[:, some]).transpose(1, 0, 2)  # (c, g, k)
            every = 0.5 * (weight @ seen[some]) - lost.T[some, :, None]  # (c, g, s)
            top = every.argmax(axis=1)
            value[chosen[some]] = np.take_along_axis(every, top[:, None], axis=1)[:, 0]
            best[chosen[some]] = GRID[top]
    return value, best
