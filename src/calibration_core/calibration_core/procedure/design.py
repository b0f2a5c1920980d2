"""Which of many candidates to measure: a D-optimal choice, by exchange, with what any choice could reach at most.

(CWA 17384, 5.4: observability of the parameters.)  Determinants compare the same way in any units, so no stiffness need
be known.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.procedure.optimum import Candidates, capped_bound, continuous
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D

SHORTLIST = 40  # candidates looked at exactly in every exchange
LEAST_GAIN = 1e-10  # of the log determinant, for an exchange to be worth making


@dataclasses.dataclass(frozen=True, eq=False)
class Choice:
    """Candidates chosen to be measured.

    Attributes:
        chosen: (N,) indices of the candidates, increasing.
        log_det: Of the mean information of the chosen ones.
        bound: No choice of N different candidates exceeds this log determinant.
        continuous_bound: Nor does any weighting of the candidates, repeated ones included, exceed this.
        parameters: Number n of parameters.
    """

    chosen: Int1D
    log_det: float
    bound: float
    continuous_bound: float
    parameters: int

    @property
    def efficiency(self) -> float:
        """(det / bound)^(1/n): this choice has at least that share of what N different candidates can tell."""
        return float(np.exp((self.log_det - self.bound) / self.parameters))

    @property
    def continuous_efficiency(self) -> float:
        """The same against the continuous optimum."""
        return float(np.exp((self.log_det - self.continuous_bound) / self.parameters))


def choose(information: Float3D, count: int, *, group: Int1D | None = None, starts: int = 6, seed: int = 0) -> Choice:
    """Choose `count` different candidates by exchange, started from several draws of the continuous optimum.

    Args:
        information: (m, n, n), positive semi-definite.
        count: How many.
        group: (m,) at most one candidate of each group is chosen (the load directions of one posture).
        starts: Number of starts; the best result is kept.
        seed: Of the draws.

    Raises:
        ValueError: Fewer groups than `count`, or the candidates do not determine all parameters.
    """
    candidates = Candidates(information)
    group = np.arange(len(information)) if group is None else np.unique(group, return_inverse=True)[1]
    if group.max(initial=-1) + 1 < count:
        msg = f"{int(group.max(initial=-1)) + 1} candidates, expected at least {count}"
        raise ValueError(msg)
    weighted = continuous(candidates)
    rng = np.random.default_rng(seed)
    best, best_value = np.empty(0, dtype=np.int64), -np.inf
    for start in range(starts):
        disorder = 0.0 if start == 0 else 1.0
        chosen = _draw(weighted.weights, group, count, disorder, rng)
        chosen, value = _exchange(candidates, chosen, group)
        if value > best_value + LEAST_GAIN:
            best, best_value = chosen, value
    shift = candidates.log_scale
    bound = min(capped_bound(candidates, best, group), weighted.bound)
    log_det = best_value - candidates.n * float(np.log(count))
    return Choice(np.sort(best), log_det + shift, bound + shift, weighted.bound + shift, candidates.n)


def rated(information: Float3D, chosen: Int1D, best: Choice) -> Choice:
    """Return another choice from the same candidates, under the bounds of the best one."""
    value = float(np.linalg.slogdet(information[chosen].mean(axis=0))[1])
    return dataclasses.replace(best, chosen=np.sort(chosen), log_det=value)


def extend(information: Float3D, chosen: Int1D, count: int, *, group: Int1D, allowed: Bool1D | None = None) -> Int1D:
    """Return `count` more candidates, each the best addition to all before it, of groups not used yet."""
    candidates = Candidates(information)
    free = ~np.isin(group, group[chosen])
    if allowed is not None:
        free &= allowed
    matrix = candidates.full[chosen].sum(axis=0)
    added: list[int] = []
    for _ in range(count):
        if not free.any():
            break
        rows = np.flatnonzero(free)
        short = rows[_largest(candidates.sensitivity(matrix, rows), SHORTLIST)]
        best = int(short[np.argmax(np.linalg.slogdet(matrix + candidates.full[short])[1])])
        added.append(best)
        matrix = matrix + candidates.full[best]
        free &= group != group[best]
    return np.array(added, dtype=np.int64)


def exchange_values(information: Float3D, chosen: Int1D, rows: Int1D) -> Float2D:
    """Return the log determinant of the mean information after every exchange of one chosen for one other candidate.

    Returns:
        (N, k): chosen i replaced by `rows[j]`.
    """
    candidates = Candidates(information)
    matrix = candidates.full[chosen].sum(axis=0)
    offset = candidates.log_scale - candidates.n * np.log(len(chosen))
    return _exchanged(candidates, matrix, chosen, rows) + offset


def _draw(weights: Float1D, group: Int1D, count: int, disorder: float, rng: np.random.Generator) -> Int1D:
    """Draw `count` candidates of different groups, with the odds of their weights (Gumbel keys)."""
    keys = np.log(weights + 1e-3 / len(weights)) + disorder * rng.gumbel(size=len(weights))
    order = np.argsort(-keys, kind="stable")
    _, first = np.unique(group[order], return_index=True)
    return order[np.sort(first)[:count]]


def _exchange(candidates: Candidates, chosen: Int1D, group: Int1D) -> tuple[Int1D, float]:
    """Make the best exchange again and again until none gains."""
    chosen = chosen.copy()
    matrix = candidates.full[chosen].sum(axis=0)
    value = float(np.linalg.slogdet(matrix)[1])
    if not np.isfinite(value):
        matrix = matrix + 1e-9 * np.eye(candidates.n)
    taken = np.zeros(int(group.max()) + 1, dtype=bool)
    taken[group[chosen]] = True
    while True:
        sensitivity = candidates.sensitivity(matrix, slice(None))
        sensitivity[chosen] = -np.inf
        short = _largest(sensitivity, SHORTLIST)
        after = _exchanged(candidates, matrix, chosen, short)
        same = group[short][None, :] == group[chosen][:, None]
        after = np.where(taken[group[short]][None, :] & ~same, -np.inf, after)
        i, j = np.unravel_index(np.argmax(after), after.shape)
        if not after[i, j] > value + LEAST_GAIN:
            return chosen, value
        taken[group[chosen[i]]] = False
        chosen[i] = short[j]
        taken[group[chosen[i]]] = True
        matrix = candidates.full[chosen].sum(axis=0)
        value = float(np.linalg.slogdet(matrix)[1])


def _exchanged(candidates: Candidates, matrix: Float2D, chosen: Int1D, rows: Int1D) -> Float2D:
    swapped = (matrix - candidates.full[chosen])[:, None] + candidates.full[rows][None]
    determinant = np.linalg.det(swapped)
    return np.where(determinant > 0, np.log(np.where(determinant > 0, determinant, 1.0)), -np.inf)


def _largest(values: Float1D, count: int) -> Int1D:
    if len(values) <= count:
        return np.arange(len(values))
    return np.argpartition(-values, count)[:count]
