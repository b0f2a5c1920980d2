"""How much any choice of candidates can tell at most: optimal weights, and bounds that hold for every choice.

Every candidate contributes an information matrix; a choice is as good as the determinant of their mean (D-optimality;
Fedorov, Theory of Optimal Experiments, 1972).  Letting candidates carry weights makes the problem concave: its optimum
bounds every choice, and any weights at all give a certified bound.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

BOUND_SLACK = 2e-3  # of the bound, as a fraction of the D-efficiency
OUTER, INNER = 60, 30  # rounds of the multiplicative algorithm: on all candidates, and on the promising ones
PROMISING = 0.85  # candidates whose sensitivity is below this share of the mean are left out of the inner rounds
CAPPED_ROUNDS = 40
INVISIBLE = 1e-20  # information on a parameter below this share of the largest is rounding
HALVINGS = 40


@dataclasses.dataclass(frozen=True, eq=False)
class Continuous:
    """The best weights on the candidates.

    Attributes:
        weights: (m,), not negative, sum one.
        log_det: Of the weighted mean information.
        bound: No weights, hence no choice, give a larger log determinant of the mean information.
    """

    weights: Float1D
    log_det: float
    bound: float


class Candidates:
    """Information matrices, scaled to similar columns, with their upper triangles packed for speed.

    Attributes:
        full: (m, n, n) scaled matrices.
        log_scale: What is added to a log determinant of scaled matrices to get that of the given ones.
        n: Number of parameters.
        packed: (m, n (n + 1) / 2) upper triangles.
    """

    def __init__(self, information: Float3D) -> None:
        diagonal = np.einsum("mii->i", information) / len(information)
        shown = diagonal > INVISIBLE * diagonal.max()  # rounding is not to be scaled up
        scale = 1.0 / np.sqrt(np.where(shown, diagonal, diagonal.max()))
        self.full = np.ascontiguousarray(information * scale[:, None] * scale)
        self.log_scale = -2.0 * float(np.log(scale).sum())
        self.n = information.shape[1]
        self.upper = np.triu_indices(self.n)
        twice = np.where(self.upper[0] == self.upper[1], 1.0, 2.0)
        self.packed = np.ascontiguousarray(self.full[:, self.upper[0], self.upper[1]])
        self.trace = np.ascontiguousarray(self.packed * twice)

    def mean(self, weights: Float1D, rows: Int1D | slice) -> Float2D:
        """Return the (n, n) weighted sum of the given candidates."""
        matrix = np.empty((self.n, self.n))
        matrix[self.upper] = weights @ self.packed[rows]
        matrix[self.upper[1], self.upper[0]] = matrix[self.upper]
        return matrix

    def sensitivity(self, matrix: Float2D, rows: Int1D | slice) -> Float1D:
        """Return tr(M^-1 X_i) of every candidate."""
        product: Float1D = self.trace[rows] @ np.linalg.inv(matrix)[self.upper]
        return product


def continuous_optimum(information: Float3D) -> Continuous:
    """Find the weights with the largest determinant, and bound it from above.

    The multiplicative algorithm (Silvey, Titterington and Torsney, 1978) raises the determinant in every round; rounds
    over all candidates alternate with many over the promising ones.  The bound holds for any weights w, by the
    inequality of arithmetic and geometric means: det M* <= det M(w) (max_i tr(M(w)^-1 X_i) / n)^n.

    Args:
        information: (m, n, n), positive semi-definite; their sum must be regular.

    Raises:
        ValueError: The sum of all matrices is singular.
    """
    candidates = Candidates(information)
    best = continuous(candidates)
    shift = candidates.log_scale
    return Continuous(best.weights, best.log_det + shift, best.bound + shift)


def continuous(candidates: Candidates) -> Continuous:
    """As `continuous_optimum`, of candidates that are packed already; log determinants of the scaled matrices."""
    m, n = len(candidates.full), candidates.n
    everything = slice(None)
    weights = np.full(m, 1.0 / m)
    if np.linalg.cond(candidates.mean(weights, everything)) > 1e12:
        msg = "the candidates together do not determine all parameters"
        raise ValueError(msg)
    bound, log_det = np.inf, -np.inf
    for _ in range(OUTER):
        matrix = candidates.mean(weights, everything)
        sensitivity = candidates.sensitivity(matrix, everything)
        log_det = float(np.linalg.slogdet(matrix)[1])
        bound = min(bound, log_det + n * float(np.log(sensitivity.max() / n)))
        if bound - log_det < n * BOUND_SLACK:
            break
        weights = weights * sensitivity / n
        rows = np.flatnonzero((sensitivity > PROMISING * n) | (weights > 1e-2 / n))
        share = np.maximum(weights[rows], 1e-6)
        for _ in range(INNER):
            inner = candidates.mean(share / share.sum(), rows)
            share = share * candidates.sensitivity(inner, rows) / n
        weights = np.full(m, 1e-9 / m)
        weights[rows] += share
        weights /= weights.sum()
    return Continuous(weights, log_det, bound)


def capped_bound(candidates: Candidates, chosen: Int1D, group: Int1D) -> float:
    """Bound the log determinant of every choice of as many candidates, at most one of each group.

    No group may then carry more than 1/N of the weight, which is a much smaller set of weights.  With d_i =
    tr(M(w)^-1 X_i), the inequality of arithmetic and geometric means gives, for any weights w,
    det M* <= det M(w) (d / n)^n with d the mean over the N groups with the largest d_i; w is improved by conditional
    gradients (Frank and Wolfe, 1956), beginning at the choice itself.

    Args:
        candidates: All of them.
        chosen: (N,) a good choice.
        group: (m,) 0 ... g-1.

    Returns:
        Bound on the log determinant of the mean of the scaled matrices.
    """
    count, n = len(chosen), candidates.n
    everything = slice(None)
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    weights = np.zeros(len(candidates.full))
    weights[chosen] = 1.0 / count
    bound = np.inf
    for _ in range(CAPPED_ROUNDS):
        matrix = candidates.mean(weights, everything)
        log_det = float(np.linalg.slogdet(matrix)[1])
        sensitivity = candidates.sensitivity(matrix, everything)
        best = np.maximum.reduceat(sensitivity[order], starts)
        top = np.argpartition(-best, count - 1)[:count]
        bound = min(bound, log_det + n * float(np.log(best[top].mean() / n)))
        if bound - log_det < 0.1 * n * BOUND_SLACK:
            break
        inside = np.isin(group, group[order][starts[top]])
        rows = np.flatnonzero(inside & (sensitivity >= best[group]))
        direction = candidates.mean(np.full(len(rows), 1.0 / len(rows)), rows)
        step = _line_search(np.linalg.eigvals(np.linalg.solve(matrix, direction)).real)
        weights *= 1.0 - step
        weights[rows] += step / len(rows)
    return bound


def _line_search(values: Float1D) -> float:
    """Return the share t that maximises sum log(1 - t + t v) over the eigenvalues v of M^-1 E."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        t = (low + high) / 2
        if ((values - 1.0) / (1.0 + t * (values - 1.0))).sum() > 0:
            low = t
        else:
            high = t
    return low
