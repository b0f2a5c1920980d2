"""Restricted likelihood of sizes: how much data ask for each block of columns, beside everything accepted.

With the null model's flat columns projected out,  y = sum_k A_k b_k + e,  b_k ~ N(0, t_k^2 I) in typical sizes and
e ~ N(0, v I), everything after one pass over the rows works on G = A'A and A'y:

    log|V| = (n - p) log v + log|L|,   L = v I + D^(1/2) G D^(1/2),
    d/d log t_k^2 = 1/2 sum((mean^2 + variance)/t_k^2 - 1) over the block.

Sizes beyond what the catalogue calls typical pay for it.

A wide block, as all orders of all gears, is turned once into the eigenvectors of its own part of G, where it stays
diagonal whatever stands beside it: L is then diagonal but for the columns of the other blocks (an arrow).
Source: Patterson and Thompson 1971 (restricted likelihood); MacKay 1992 (shared sizes); Gilmour, Thompson and Cullis
1995 (average information, with which the optimum is found in a few steps).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import cholesky
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dtrtri

from calibration_core.timeseries import Float1D, Float2D, Int1D

USUAL = 3.0  # typical sizes up to which nothing is paid
DEAR = 0.7  # standard deviation of the logarithm beyond
LEAST, MOST = 1e-3, 60.0  # sizes that are tried, typical
ITERATIONS = 60
STRIDE = 2.0  # of a logarithm, in one iteration
FLATTEST = 0.02  # curvature, nats: a size of which the data say nothing moves little
PRECISION, LEAST_SHARE = 1e-6, 0.1  # nats; share of what is expected of a step that it must reach
JITTER = 1e-9  # of the diagonal: what projecting out loses in digits
WIDE = 96  # columns of a block from which on its eigenvectors are kept
BESIDE = 3  # times as wide as what stands beside it a block must be, for them to be of use at many sizes


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
    """Say whether the eigenvectors of a block of some width are of use at many sizes beside some other columns."""
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
    likelihood = Likelihood(gram, blocks)
    variance = gram.square / gram.freedom if start is None else start.variance
    sizes = np.full(len(blocks), 0.3) if start is None else start.size
    x = np.concatenate([[np.log(variance)], np.log(np.clip(sizes, LEAST, MOST))])
    low = np.concatenate([[x[0] - 12], np.full(len(blocks), np.log(LEAST))])
    high = np.concatenate([[x[0] + 5], np.full(len(blocks), np.log(MOST))])
    here = likelihood.at(x)
    for _ in range(ITERATIONS):
        free = np.flatnonzero(~((x <= low) & (here.slope > 0)) & ~((x >= high) & (here.slope < 0)))
        curvature = here.information[np.ix_(free, free)] + FLATTEST * np.eye(len(free))
        step = np.zeros_like(x)
        step[free] = np.clip(-np.linalg.solve(curvature, here.slope[free]), -STRIDE, STRIDE)
        lower = _lower(likelihood, x, here, np.clip(x + step, low, high) - x)
        if lower is None:
            break
        x, here = lower
    return Sizes(float(np.exp(x[0])), np.exp(x[1:]), -here.value)


def _lower(likelihood: Likelihood, x: Float1D, here: Point, step: Float1D) -> tuple[Float1D, Point] | None:
    """Return where a step leads, shortened until the value falls as its slope says; None: it will not fall."""
    expected = -float(here.slope @ step)
    while expected > PRECISION:
        there = likelihood.at(x + step)
        if there.value <= here.value - LEAST_SHARE * expected:
            return x + step, there
        step, expected = step / 2, expected / 2
    return None


@dataclasses.dataclass(frozen=True, eq=False)
class Point:
    """A value of the negative log likelihood, and what it is about there.

    Attributes:
        value: Nats.
        slope: (1 + k,), with the logarithms of noise and sizes.
        information: (1 + k, 1 + k), likewise: the average of its observed and its expected curvature.
    """

    value: float
    slope: Float1D
    information: Float2D


class Likelihood:
    """The negative log likelihood of some blocks, as a function of the logarithms of noise and sizes.

    Args:
        gram: The rows.
        blocks: Columns of the k blocks; no column in two.
    """

    def __init__(self, gram: Gram, blocks: Sequence[Int1D]) -> None:
        self._gram, self._inner = gram, _inner(gram, blocks)
        self._group = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])

    def at(self, x: Float1D) -> Point:
        """Evaluate it at the logarithms of v and of every size, (1 + k,).

        With s = L^-1 D A'y and f_k = A_k D_k s_k, f_0 = y - A D s, the average information of two blocks is
        2 f_k' P f_l, P being the precision with the flat columns projected out: f_k' P f_l = s_k' (I - v L^-1) s_l
        (Gilmour, Thompson and Cullis 1995).
        """
        gram, group = self._gram, self._group
        variance, size = float(np.exp(x[0])), np.exp(x[1:])
        d, k, p = size[group], len(size), len(group)
        found = self._inner.at(variance, d)
        solved = found.vector
        left = gram.square - float((d * self._inner.vector) @ solved)  # v y'Py
        over = np.log(np.maximum(size / USUAL, 1.0))
        value = 0.5 * ((gram.freedom - p) * x[0] + found.log_determinant + left / variance) + price(size).sum()
        squares = np.bincount(group, solved**2, minlength=k)
        spread = np.bincount(group, variance * found.diagonal - 1, minlength=k)
        own = left / variance - squares.sum()  # v y'PPy
        noise = 0.5 * (gram.freedom + spread.sum() - own)
        slope = np.concatenate([[noise], over / DEAR**2 - squares - spread])
        each = np.zeros((p, k))
        each[np.arange(p), group] = solved
        beyond = found.solve(np.column_stack([solved, each]))
        shared = each.T @ beyond  # of every block with L^-1 s, and with that of every other
        information = np.empty((k + 1, k + 1))
        information[0, 0] = 0.5 * (own - variance * float(solved @ beyond[:, 0]))
        information[0, 1:] = information[1:, 0] = variance * shared[:, 0]
        information[1:, 1:] = 2 * (np.diag(squares) - variance * shared[:, 1:]) + np.diag((size > USUAL) / DEAR**2)
        return Point(float(value), slope, information)


@dataclasses.dataclass(frozen=True, eq=False)
class _Solved:
    """What is asked of L = v I + D G D.

    Attributes:
        log_determinant: Log |L|.
        vector: (p,) L^-1 D A'y.
        diagonal: (p,) of L^-1.
        solve: (p, c) -> (p, c), L^-1 times some columns.
    """

    log_determinant: float
    vector: Float1D
    diagonal: Float1D
    solve: Callable[[Float2D], Float2D]


@dataclasses.dataclass(frozen=True, eq=False)
class _Dense:
    """L = v I + D G D of some columns, and what is asked of it.

    Attributes:
        matrix: (p, p) G.
        vector: (p,) A'y.
    """

    matrix: Float2D
    vector: Float1D

    def at(self, variance: float, d: Float1D) -> _Solved:
        """Return what is asked of L at a variance v and sizes d, (p,)."""
        lower, root = _factor(variance * np.eye(len(d)) + d[:, None] * self.matrix * d)

        def solve(right: Float2D) -> Float2D:
            return np.asarray(root.T @ (root @ right))

        through = solve((d * self.vector)[:, None])[:, 0]
        return _Solved(2 * float(np.log(lower).sum()), through, np.einsum("ij,ij->j", root, root), solve)


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

    def at(self, variance: float, d: Float1D) -> _Solved:
        """Return as `_Dense`; within the wide block in its basis, in which its sums of squares are the same."""
        w = len(self.own)
        size, few = d[self.order[:w]], d[self.order[w:]]
        wide = variance + size**2 * self.own
        shared = size[:, None] * self.beside * few
        through = shared / wide[:, None]
        half = shared / np.sqrt(wide)[:, None]
        lower, root = _factor(variance * np.eye(len(few)) + few[:, None] * self.others * few - half.T @ half)

        def solve(right: Float2D) -> Float2D:
            own, others = right[self.order[:w]], right[self.order[w:]]
            of_others = root.T @ (root @ (others - through.T @ own))
            solved = np.empty_like(right)
            solved[self.order] = np.concatenate([own / wide[:, None] - through @ of_others, of_others])
            return solved

        back = np.asarray(dtrmm(1.0, root, through, side=1, lower=1, trans_a=1))
        diagonal, right = np.empty(len(d)), np.empty(len(d))
        diagonal[self.order] = np.concatenate(
            [1 / wide + np.einsum("wa,wa->w", back, back), np.einsum("ij,ij->j", root, root)]
        )
        right[self.order] = d[self.order] * self.turned
        log_determinant = float(np.log(wide).sum()) + 2 * float(np.log(lower).sum())
        return _Solved(log_determinant, solve(right[:, None])[:, 0], diagonal, solve)


def _inner(gram: Gram, blocks: Sequence[Int1D]) -> _Dense | _Arrow:
    """Return G and A'y of some blocks in the form that suits them."""
    members = np.concatenate(blocks)
    widest = max(range(len(blocks)), key=lambda k: len(blocks[k]))
    w = len(blocks[widest])
    if w < WIDE:
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
    """Return the diagonal of the Cholesky factor of a positive matrix, and the inverse of the factor."""
    if not len(matrix):
        return np.zeros(0), matrix
    lower = cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)
    diagonal = np.diag(lower).copy()
    root, _ = dtrtri(lower, lower=True, overwrite_c=True)
    return diagonal, np.asarray(root)
