"""Evenly spaced in the operating space, as CWA 17384, 5.1 asks, without giving up what the choice tells."""

from __future__ import annotations

import numpy as np

from calibration_core.planning.optimal_design.criteria import Criterion
from calibration_core.planning.optimal_design.design import exchange_scores
from calibration_core.planning.optimal_design.optimum import Candidates
from calibration_core.timeseries import Float2D, Int1D

LOOKED_AT = 300  # candidates per round
ROUNDS = 60
LEAST_GAIN = 1e-3  # of the spacing, for a round to be worth it


def spacing(space: Float2D, chosen: Float2D) -> float:
    """Return the mean distance, m, from places of the operating space (s, 3) to the nearest chosen place (N, 3)."""
    return float(np.linalg.norm(space[:, None] - chosen[None], axis=2).min(axis=1).mean())


def spread_out(
    candidates: Candidates,
    criterion: Criterion,
    chosen: Int1D,
    place: Float2D,
    group: Int1D,
    space: Float2D,
    floor: float,
    seed: int,
) -> Int1D:
    """Exchange candidates so that the chosen ones lie more evenly, as long as the score stays above a floor.

    Args:
        candidates: To choose from.
        criterion: What makes a choice good.
        chosen: (N,) the choice to begin with.
        place: (m, 3) m, where each candidate measures.
        group: (m,) at most one of each group.
        space: (s, 3) m, sample of the operating space.
        floor: Least score of the mean information.
        seed: Of the candidates looked at.
    """
    rng = np.random.default_rng([seed, 2])
    chosen = chosen.copy()
    gap = np.linalg.norm(space[:, None] - place[chosen][None], axis=2)  # (s, N)
    now = float(gap.min(axis=1).mean())
    for _ in range(ROUNDS):
        rows = rng.choice(len(place), min(LOOKED_AT, len(place)), replace=False)
        rows = rows[~np.isin(rows, chosen)]
        value = exchange_scores(candidates, criterion, chosen, rows)
        foreign = group[rows][None, :] != group[chosen][:, None]
        taken = np.isin(group[rows], group[chosen])[None, :] & foreign
        value[taken] = -np.inf
        new = np.linalg.norm(space[:, None] - place[rows][None], axis=2)  # (s, k)
        after = np.full(value.shape, np.inf)
        for i in range(len(chosen)):
            allowed = np.flatnonzero(value[i] >= floor)
            if len(allowed):
                rest = np.delete(gap, i, axis=1).min(axis=1)
                after[i, allowed] = np.minimum(rest[:, None], new[:, allowed]).mean(axis=0)
        i, j = divmod(int(np.argmin(after)), len(rows))
        if after[i, j] < now * (1 - LEAST_GAIN):
            chosen[i], gap[:, i], now = rows[j], new[:, j], float(after[i, j])
    return np.sort(chosen)
