"""How much any choice of candidates can tell at most: optimal weights, and bounds that hold for every choice.

Every candidate contributes an information matrix; a choice is as good as a criterion of their mean says (see
`criteria`).  Letting candidates carry weights makes the problem concave: its optimum bounds every choice, and any
weights at all give a certified bound.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.planning.optimal_design.criteria import D_OPTIMAL, Criterion
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

BOUND_SLACK = 2e-3  # of the bound, as a fraction of the efficiency
OUTER, INNER = 40, 120  # rounds of the multiplicative algorithm: on all candidates, and on the promising ones
PROMISING = 24  # candidates per parameter that the inner rounds begin with
CAPPED_ROUNDS = 40
PATIENCE = 6  # rounds in which a bound may stay as it is
INVISIBLE = 1e-20  # information on a parameter below this share of the largest is rounding
LEAST_DETERMINED = 1e-12  # smallest eigenvalue over the largest, of the scaled mean information
STEPS = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 24)])  # shares looked at in a line search


@dataclasses.dataclass(frozen=True, eq=False)
class Continuous:
    """The best weights on the candidates.

    Attributes:
        weights: (m,), not negative, sum one.
        score: Of the weighted mean information.
        bound: No weights, hence no choice, give a larger score; infinite for a criterion that is not concave.
    """

    weights: Float1D
    score: float
    bound: float


class Candidates:
    """Information matrices in units of the parameters' scale, upper triangles only.

    Attributes:
        scale: (n,) size of each parameter: given, or such that all are about equally well seen.
        packed: (m, n (n + 1) / 2) upper triangles.
    """

    def __init__(self, information: Float3D, scale: Float1D | None = None) -> None:
        """Scale and pack.

        Args:
            information: (m, n, n), positive semi-definite, in SI units.
            scale: (n,) unit in which an error of each parameter counts (the nominal value, for relative errors); None:
                from the candidates' mean.
        """
        n = information.shape[1]
        if scale is None:
            diagonal = np.einsum("mii->i", information) / max(len(information), 1)
            shown = diagonal > INVISIBLE * diagonal.max(initial=0.0)  # rounding is not to be scaled up
            scale = 1.0 / np.sqrt(np.where(shown, diagonal, max(diagonal.max(initial=0.0), 1e-300)))
        self.scale = np.asarray(scale, dtype=np.float64)
        self.upper = np.triu_indices(n)
        self.twice = np.where(self.upper[0] == self.upper[1], 1.0, 2.0)
        self.packed = information[:, self.upper[0], self.upper[1]]
        self.packed *= self.scale[self.upper[0]] * self.scale[self.upper[1]]

    @property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.scale)

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.packed)

    def _unpacked(self, packed: Float2D) -> Float3D:
        matrices = np.empty((*packed.shape[:-1], self.n, self.n))
        matrices[..., self.upper[0], self.upper[1]] = packed
        matrices[..., self.upper[1], self.upper[0]] = packed
        return matrices

    def matrices(self, rows: Int1D) -> Float3D:
        """Return the (k, n, n) scaled information of some candidates."""
        return self._unpacked(self.packed[rows])

    def mean(self, weights: Float1D, packed: Float2D | None = None) -> Float2D:
        """Return the (n, n) weighted sum of all candidates, or of the given packed ones."""
        return self._unpacked(weights @ (self.packed if packed is None else packed))

    def total(self, rows: Int1D) -> Float2D:
        """Return the (n, n) sum of some candidates."""
        return self._unpacked(self.packed[rows].sum(axis=0))

    def sensitivity(self, slope: Float2D, packed: Float2D | None = None) -> Float1D:
        """Return tr(G X_i) of every candidate, or of the given packed ones."""
        product: Float1D = (self.packed if packed is None else packed) @ (self.twice * slope[self.upper])
        return product

    def subset(self, rows: Int1D) -> Candidates:
        """Return some of the candidates, at the same scale."""
        part = object.__new__(Candidates)
        part.scale, part.upper, part.twice, part.packed = self.scale, self.upper, self.twice, self.packed[rows]
        return part

    def determined(self) -> bool:
        """Whether all candidates together determine all parameters."""
        values = np.linalg.eigvalsh(self.mean(np.full(len(self), 1.0 / len(self))))
        return bool(values[0] > LEAST_DETERMINED * values[-1])


def continuous_optimum(candidates: Candidates, criterion: Criterion = D_OPTIMAL) -> Continuous:
    """Find the weights with the best score, and bound it from above.

    The multiplicative algorithm (Silvey, Titterington and Torsney, 1978) raises the criterion in every round; rounds
    over all candidates alternate with many over the promising ones.  For a criterion that is not concave the weights
    are those of the determinant.

    Raises:
        ValueError: The sum of all candidates is singular.
    """
    if not candidates.determined():
        msg = "the candidates together do not determine all parameters"
        raise ValueError(msg)
    if not criterion.concave:
        found = continuous_optimum(candidates)
        score = float(criterion.score(candidates.mean(found.weights)[None])[0])
        return Continuous(found.weights, score, np.inf)
    m = len(candidates)
    weights = np.full(m, 1.0 / m)
    bound, score = np.inf, -np.inf
    for _ in range(OUTER):
        matrix = candidates.mean(weights)
        gain = candidates.sensitivity(criterion.slope(matrix))
        score = float(criterion.smooth(matrix[None])[0])
        bound = min(bound, score + float(np.log(gain.max())))
        if bound - score < BOUND_SLACK:
            break
        weights = _inner(candidates, criterion, weights, gain)
    return Continuous(weights, float(criterion.score(candidates.mean(weights)[None])[0]), bound)


def _inner(candidates: Candidates, criterion: Criterion, weights: Float1D, gain: Float1D) -> Float1D:
    """Improve the weights of the promising candidates alone."""
    m, most = len(candidates), PROMISING * candidates.n
    promising = np.argpartition(-gain, most)[:most] if m > most else np.arange(m)
    rows = np.union1d(promising, np.flatnonzero(weights > 1e-6)) if m > most else promising
    packed = candidates.packed[rows]
    share = weights[rows]
    entering = np.where(gain[rows] > 1.0, 0.02 / len(rows), 0.0)  # what would help but has no weight yet
    share = np.maximum(share / max(share.sum(), 1e-300), entering)
    share /= share.sum()
    for _ in range(INNER):
        inner = np.maximum(candidates.sensitivity(criterion.slope(candidates.mean(share, packed)), packed), 0.0)
        share = share * inner**criterion.power
        share /= share.sum()
    improved = np.zeros(m)
    improved[rows] = np.where(share > 1e-8, share, 0.0)
    return np.asarray(improved / improved.sum())


def capped_bound(candidates: Candidates, criterion: Criterion, chosen: Int1D, group: Int1D) -> float:
    """Bound the score of every choice of as many candidates, at most one of each group.

    No group may then carry more than 1/N of the weight, which is a much smaller set of weights: the largest tr(G X_i)
    of the general bound becomes its mean over the N groups that have the largest.  The weights at which the bound is
    taken are improved by conditional gradients (Frank and Wolfe, 1956), beginning at the choice itself.

    Args:
        candidates: All of them.
        criterion: Concave.
        chosen: (N,) a good choice.
        group: (m,) 0 ... g-1.
    """
    count = len(chosen)
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    matrix = candidates.total(chosen) / count
    bound, waited = np.inf, 0
    for _ in range(CAPPED_ROUNDS):
        gain = candidates.sensitivity(criterion.slope(matrix))
        best = np.maximum.reduceat(gain[order], starts)
        top = np.argpartition(-best, count - 1)[:count]
        score = float(criterion.smooth(matrix[None])[0])
        found = score + float(np.log(best[top].mean()))
        waited = 0 if found < bound - 0.05 * BOUND_SLACK else waited + 1
        bound = min(bound, found)
        if bound - score < 0.1 * BOUND_SLACK or waited > PATIENCE:
            break
        inside = np.isin(group, group[order][starts[top]])
        rows = np.flatnonzero(inside & (gain >= best[group]))
        direction = candidates.total(rows) / len(rows)
        ways = matrix + STEPS[:, None, None] * (direction - matrix)
        matrix = ways[max(int(np.argmax(criterion.smooth(ways))), 1)]
    return bound
