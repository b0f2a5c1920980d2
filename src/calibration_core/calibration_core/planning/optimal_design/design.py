"""Which of many candidates to measure: the best choice by exchange, with what any choice could reach at most.

(CWA 17384, 5.4: observability of the parameters.)
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.planning.optimal_design.criteria import D_OPTIMAL, Criterion
from calibration_core.planning.optimal_design.optimum import Candidates, capped_bound, continuous_optimum
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

SHORTLIST = 40  # candidates looked at exactly before an exchange is given up
FEW, LEAST_TELLING = 12, 6  # candidates, and chosen ones that tell least, looked at first
NEAR = 1500  # candidates, the best at the continuous optimum, that the starts exchange with
LEAST_GAIN = 1e-10  # of the score, for an exchange to be worth making


@dataclasses.dataclass(frozen=True, eq=False)
class ExchangeResult:
    """Candidates chosen to be measured.

    Attributes:
        criterion: What was wanted.
        chosen: (N,) indices of the candidates, increasing.
        score: Of the mean information of the chosen ones, in units of the candidates' scale.
        bound: No choice of N different candidates has a larger score; infinite where nothing certifies one.
    """

    criterion: Criterion
    chosen: Int1D
    score: float
    bound: float

    @property
    def efficiency(self) -> float | None:
        """Share of what N different candidates can tell that this choice has for certain; None without a certificate.

        For the determinant (det / det*)^(1/n), for variances the ratio of the least that are possible to these.
        """
        return float(np.exp(self.score - self.bound)) if np.isfinite(self.bound) else None


def choose(
    candidates: Candidates,
    count: int,
    *,
    criterion: Criterion = D_OPTIMAL,
    group: Int1D | None = None,
    starts: int = 6,
    seed: int = 0,
    repeated: bool = False,
) -> ExchangeResult:
    """Choose `count` different candidates by exchange, started from several draws of the continuous optimum.

    Args:
        candidates: To choose from.
        count: How many.
        criterion: What makes a choice good.
        group: (m,) at most one candidate of each group is chosen (the load directions of one posture).
        starts: Number of starts; the best result is kept.
        seed: Of the draws.
        repeated: Whether a candidate may be chosen more than once; groups are then passed over.

    Raises:
        ValueError: Fewer groups than `count`, or the candidates do not determine all parameters.
    """
    group = np.arange(len(candidates)) if group is None else np.unique(group, return_inverse=True)[1]
    if group.max(initial=-1) + 1 < count:
        msg = f"{int(group.max(initial=-1)) + 1} candidates, expected at least {count}"
        raise ValueError(msg)
    weighted = continuous_optimum(candidates, criterion)
    gain = candidates.sensitivity(criterion.slope(candidates.mean(weighted.weights)))
    near = _near(gain, weighted.weights, group, count)
    part, part_group = candidates.subset(near), group[near]
    rng = np.random.default_rng(seed)
    best, best_score = np.empty(0, dtype=np.int64), -np.inf
    for start in range(starts):
        disorder = 0.0 if start == 0 else 1.0
        chosen = _draw(weighted.weights[near], part_group, count, disorder, rng)
        chosen, score = _exchange(part, criterion, chosen, part_group, repeated=repeated)
        if score > best_score + LEAST_GAIN or not len(best):
            best, best_score = near[chosen], score
    best, best_score = _exchange(candidates, criterion, best, group, repeated=repeated)
    bound = weighted.bound
    if criterion.concave and not repeated:
        bound = min(capped_bound(candidates, criterion, best, group), bound)
    return ExchangeResult(criterion, np.sort(best), best_score, bound)


def rated(candidates: Candidates, chosen: Int1D, best: ExchangeResult) -> ExchangeResult:
    """Return another choice from the same candidates, under the bounds of the best one."""
    score = float(best.criterion.score(candidates.total(chosen)[None] / len(chosen))[0])
    return dataclasses.replace(best, chosen=np.sort(chosen), score=score)


def extend(
    candidates: Candidates,
    chosen: Int1D,
    count: int,
    *,
    group: Int1D,
    criterion: Criterion = D_OPTIMAL,
    allowed: Bool1D | None = None,
) -> Int1D:
    """Return `count` more candidates, each the best addition to all before it, of groups not used yet."""
    free = ~np.isin(group, group[chosen])
    if allowed is not None:
        free &= allowed
    matrix = candidates.total(chosen)
    added: list[int] = []
    for _ in range(count):
        rows = np.flatnonzero(free)
        if not len(rows):
            break
        gain = candidates.sensitivity(criterion.slope(matrix))[rows]
        short = rows[_largest(gain, SHORTLIST)]
        best = int(short[np.argmax(criterion.score(matrix + candidates.matrices(short)))])
        added.append(best)
        matrix = matrix + candidates.matrices(np.array([best]))[0]
        free &= group != group[best]
    return np.array(added, dtype=np.int64)


def exchange_scores(candidates: Candidates, criterion: Criterion, chosen: Int1D, rows: Int1D) -> Float2D:
    """Return the score of the mean information after every exchange of one chosen for one other candidate.

    Returns:
        (N, k): chosen i replaced by `rows[j]`.
    """
    rest = (candidates.total(chosen) - candidates.matrices(chosen)) / len(chosen)
    return _exchanged(criterion, rest, candidates.matrices(rows) / len(chosen))


def _near(gain: Float1D, weights: Float1D, group: Int1D, count: int) -> Int1D:
    """Return the candidates worth exchanging with, increasing: the best ones, and enough groups of them."""
    if len(gain) <= NEAR:
        return np.arange(len(gain))
    order = np.argsort(-gain, kind="stable")
    kept = order[:NEAR]
    _, first = np.unique(group[order], return_index=True)
    groups = order[np.sort(first)[: 2 * count]]
    return np.unique(np.concatenate([kept, groups, np.flatnonzero(weights > 1e-6)]))


def _draw(weights: Float1D, group: Int1D, count: int, disorder: float, rng: np.random.Generator) -> Int1D:
    """Draw `count` candidates of different groups, with the odds of their weights (Gumbel keys)."""
    keys = np.log(weights + 1e-3 / len(weights)) + disorder * rng.gumbel(size=len(weights))
    order = np.argsort(-keys, kind="stable")
    _, first = np.unique(group[order], return_index=True)
    return order[np.sort(first)[:count]]


def _exchange(
    candidates: Candidates, criterion: Criterion, chosen: Int1D, group: Int1D, *, repeated: bool
) -> tuple[Int1D, float]:
    """Make the best exchange again and again until none gains."""
    count = len(chosen)
    chosen = chosen.copy()
    taken = np.zeros(int(group.max()) + 1, dtype=bool)
    taken[group[chosen]] = True
    while True:
        matrix = candidates.total(chosen) / count
        score = float(criterion.score(matrix[None])[0])
        gain = candidates.sensitivity(criterion.slope(matrix))
        least = np.argsort(gain[chosen], kind="stable")
        if not repeated:
            gain[chosen] = -np.inf
        for leaving, offered in ((LEAST_TELLING, FEW), (count, SHORTLIST)):
            out, short = least[:leaving], _largest(gain, offered)
            rest = matrix - candidates.matrices(chosen[out]) / count
            after = _exchanged(criterion, rest, candidates.matrices(short) / count)
            if not repeated:
                same = group[short][None, :] == group[chosen[out]][:, None]
                after = np.where(taken[group[short]][None, :] & ~same, -np.inf, after)
            i, j = np.unravel_index(np.argmax(after), after.shape)
            if after[i, j] > score + LEAST_GAIN:
                break
        else:
            return chosen, score
        taken[group[chosen[out[i]]]] = False
        chosen[out[i]] = short[j]
        taken[group[chosen[out[i]]]] = True


def _exchanged(criterion: Criterion, rest: Float2D, added: Float2D) -> Float2D:
    """Return the (N, k) scores of rest i plus addition j."""
    sums = rest[:, None] + added[None]
    scores = criterion.score(sums.reshape(-1, *sums.shape[2:]))
    return scores.reshape(sums.shape[:2])


def _largest(values: Float1D, count: int) -> Int1D:
    if len(values) <= count:
        return np.arange(len(values))
    return np.argpartition(-values, count)[:count]
