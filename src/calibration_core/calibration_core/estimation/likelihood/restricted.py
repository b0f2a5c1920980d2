"""Restricted likelihood of sizes: how much data ask for each block of columns, beside everything accepted.

With the null model's flat columns projected out,  y = sum_k A_k b_k + e,  b_k ~ N(0, t_k^2 I) in typical sizes and
e ~ N(0, v I), everything after one pass over the rows works on G = A'A and A'y:

    log|V| = (n - p) log v + log|L|,   L = v I + D^(1/2) G D^(1/2),
    d/d log t_k^2 = 1/2 sum((mean^2 + variance)/t_k^2 - 1) over the block.

Sizes beyond what the catalogue calls typical pay for it.

A wide block, as all orders of all gears, is turned once into the eigenvectors of its own part of G, where it stays
diagonal whatever stands beside it: L is then diagonal but for the columns of the other blocks (an arrow).
Source: Patterson and Thompson 1971 (restricted likelihood); MacKay 1992 (shared sizes).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize

from calibration_core.timeseries import Float1D, Float2D, Int1D

USUAL = 3.0  # typical sizes up to which nothing is paid
DEAR = 0.7  # standard deviation of the logarithm beyond
LEAST, MOST = 1e-3, 60.0  # sizes that are tried, typical
ITERATIONS = 60
JITTER = 1e-9  # of the diagonal: what projecting out loses in digits
WIDE = 96  # columns of a block from which on its eigenvectors are kept
BESIDE = 3  # times as wide as what stands beside it a block must be, for them to be of use


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
    _bases: dict[bytes, tuple[Float1D, Float2D]] = dataclasses.field(default_factory=dict, repr=False)

    def basis(self, block: Int1D) -> tuple[Float1D, Float2D]:
        """Return the eigenvalues (k,) of a block's own part of the matrix, rising, and their vectors, (k, k)."""
        key = block.tobytes()
        if key not in self._bases:
            own, turn = np.linalg.eigh(self.matrix[np.ix_(block, block)])
            self._bases[key] = np.maximum(own, 0.0), turn
        return self._bases[key]


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


def basis_serves(width: int, others: int) -> bool:
    """Say whether the eigenvectors of a block of some width are of use beside some other columns."""
    return width >= max(WIDE, BESIDE * others)


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
    group = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
    p, inner = len(group), _inner(gram, blocks)

    def negative(x: Float1D) -> tuple[float, Float1D]:
        variance, size = np.exp(x[0]), np.exp(x[1:])
        d = size[group]
        log_determinant, solved, diagonal = inner.at(variance, d)
        taken = float((d * inner.vector) @ solved)
        misfit = (gram.square - taken) / variance
        over = np.log(np.maximum(size / USUAL, 1.0))
        value = 0.5 * ((gram.freedom - p) * x[0] + log_determinant + misfit) + price(size).sum()
        spread = variance * diagonal
        slope = np.bincount(group, solved**2 + spread - 1, minlength=len(blocks)) - over / DEAR**2
        left = gram.square - taken + variance * (p - float(solved @ solved) - float(spread.sum()))
        return float(value), -np.concatenate([[0.5 * (left / variance - gram.freedom)], slope])

    variance = gram.square / gram.freedom if start is None else start.variance
    sizes = np.full(len(blocks), 0.3) if start is None else start.size
    begin = np.concatenate([[np.log(variance)], np.log(sizes)])
    bounds = [(begin[0] - 12, begin[0] + 5)] + [(np.log(LEAST), np.log(MOST))] * len(blocks)
    options = {"maxiter": ITERATIONS, "ftol": 1e-8}
    best = minimize(negative, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return Sizes(float(np.exp(best.x[0])), np.exp(best.x[1:]), -float(best.fun))


@dataclasses.dataclass(frozen=True, eq=False)
class _Dense:
    """L = v I + D G D of some columns, and what is asked of it.

    Attributes:
        matrix: (p, p) G.
        vector: (p,) A'y.
    """

    matrix: Float2D
    vector: Float1D

    def at(self, variance: float, d: Float1D) -> tuple[float, Float1D, Float1D]:
        """Return log|L|, L^-1 D A'y (p,) and the diagonal of L^-1, (p,)."""
        lower, inverse = _factor(variance * np.eye(len(d)) + d[:, None] * self.matrix * d)
        return 2 * float(np.log(lower).sum()), inverse @ (d * self.vector), np.diag(inverse)


@dataclasses.dataclass(frozen=True, eq=False)
class _Arrow:
    """The same where one wide block is diagonal, in the basis of its eigenvectors, and the others are few.

    Attributes:
        order: (p,) where the wide block's columns, then the others, stand.
        own: (w,) eigenvalues of the wide block.
        beside: (w, a) what it shares with the others.
        others: (a, a) G of the others.
        turned: (p,) A'y, the wide block's in its basis, in the order of `order`.
        vector: (p,) the same in the order of the blocks.
    """

    order: Int1D
    own: Float1D
    beside: Float2D
    others: Float2D
    turned: Float1D
    vector: Float1D

    def at(self, variance: float, d: Float1D) -> tuple[float, Float1D, Float1D]:
        """Return as `_Dense`; within the wide block in its basis, in which its sums of squares are the same."""
        w = len(self.own)
        size, few = d[self.order[:w]], d[self.order[w:]]
        wide = variance + size**2 * self.own
        shared = size[:, None] * self.beside * few
        through = shared / wide[:, None]
        lower, inverse = _factor(variance * np.eye(len(few)) + few[:, None] * self.others * few - shared.T @ through)
        right = d[self.order] * self.turned
        of_others = inverse @ (right[w:] - through.T @ right[:w])
        back = through @ inverse
        solved, diagonal = np.empty(len(d)), np.empty(len(d))
        solved[self.order] = np.concatenate([right[:w] / wide - through @ of_others, of_others])
        diagonal[self.order] = np.concatenate([1 / wide + np.einsum("wa,wa->w", back, through), np.diag(inverse)])
        return float(np.log(wide).sum()) + 2 * float(np.log(lower).sum()), solved, diagonal


def _inner(gram: Gram, blocks: Sequence[Int1D]) -> _Dense | _Arrow:
    """Return G and A'y of some blocks in the form that suits them."""
    members = np.concatenate(blocks)
    widest = max(range(len(blocks)), key=lambda k: len(blocks[k]))
    w = len(blocks[widest])
    if not basis_serves(w, len(members) - w):
        matrix = gram.matrix[np.ix_(members, members)]
        return _Dense(matrix + JITTER * np.diag(np.diag(matrix)), gram.vector[members])
    own, turn = gram.basis(blocks[widest])
    first = sum(len(block) for block in blocks[:widest])
    inside = np.zeros(len(members), dtype=bool)
    inside[first : first + w] = True
    others = members[~inside]
    among = gram.matrix[np.ix_(others, others)]
    turned = turn.T @ np.column_stack([gram.vector[blocks[widest]], gram.matrix[np.ix_(blocks[widest], others)]])
    right, order = np.concatenate([turned[:, 0], gram.vector[others]]), np.argsort(~inside, kind="stable")
    vector = np.empty(len(members))
    vector[order] = right
    return _Arrow(order, own * (1 + JITTER), turned[:, 1:], among + JITTER * np.diag(np.diag(among)), right, vector)


def _factor(matrix: Float2D) -> tuple[Float1D, Float2D]:
    """Return the diagonal of the Cholesky factor of a positive matrix, and the inverse."""
    if not len(matrix):
        return np.zeros(0), matrix
    lower = cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)
    inverse, _ = dpotri(lower, lower=True)
    full = np.tril(inverse)
    return np.diag(lower), full + np.tril(full, -1).T
