"""The choice is good by every criterion, the bounds hold, and groups are respected."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from calibration_core.planning.optimal_design.criteria import CRITERIA, Criterion, Observability
from calibration_core.planning.optimal_design.design import choose, exchange_scores, extend, rated
from calibration_core.planning.optimal_design.optimum import Candidates, continuous_optimum

ALL = [pytest.param(one, id=name) for name, one in CRITERIA.items()]
CONCAVE = [pytest.param(one, id=name) for name, one in CRITERIA.items() if one.concave]


def _matrices(seed: int, m: int, n: int, rows: int = 3) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(m, rows, n)) * np.geomspace(1, 1e-4, n)
    return a.transpose(0, 2, 1) @ a


def _score(criterion: Criterion, candidates: Candidates, chosen: np.ndarray) -> float:
    return float(criterion.score(candidates.matrices(chosen).mean(axis=0)[None])[0])


@pytest.mark.parametrize("criterion", ALL)
@pytest.mark.parametrize("seed", range(3))
def test_best_of_all_choices_is_found_and_never_exceeds_the_bound(criterion: Criterion, seed: int) -> None:
    candidates = Candidates(_matrices(seed, 12, 3))
    scores = [_score(criterion, candidates, np.array(chosen)) for chosen in combinations(range(12), 4)]
    result = choose(candidates, 4, criterion=criterion)
    assert max(scores) - 1e-12 <= result.bound <= continuous_optimum(candidates, criterion).bound
    near = 1e-9 if criterion.concave else 0.05  # small enough for the exchange to find the best
    assert result.score == pytest.approx(max(scores), abs=near)
    assert result.score == pytest.approx(_score(criterion, candidates, result.chosen), abs=1e-9)
    assert (result.efficiency is None) is not criterion.concave


@pytest.mark.parametrize("criterion", ALL)
def test_slope_is_the_derivative_of_the_criterion(criterion: Criterion) -> None:
    rng = np.random.default_rng(8)
    matrix = Candidates(_matrices(8, 20, 4)).mean(np.full(20, 0.05))
    for _ in range(5):
        way = rng.normal(size=(4, 4))
        way = 1e-5 * (way + way.T)
        change = criterion.smooth(np.stack([matrix + way, matrix - way]))
        assert np.sum(criterion.slope(matrix) * way) == pytest.approx((change[0] - change[1]) / 2, rel=1e-5, abs=1e-12)
    assert np.sum(criterion.slope(matrix) * matrix) == pytest.approx(1.0 if criterion.concave else 0.0, abs=1e-6)
    assert criterion.score(matrix[None])[0] <= criterion.smooth(matrix[None])[0] + 1e-12


@pytest.mark.parametrize("criterion", ALL)
def test_every_criterion_is_best_by_itself(criterion: Criterion) -> None:
    candidates = Candidates(_matrices(7, 400, 5))
    own = choose(candidates, 15, criterion=criterion)
    for other in CRITERIA.values():
        foreign = rated(candidates, choose(candidates, 15, criterion=other).chosen, own)
        assert own.score >= foreign.score - 1e-3


def test_figures_of_the_standard_are_those_of_the_jacobian() -> None:
    jacobian = np.random.default_rng(2).normal(size=(30, 5))
    singular = np.linalg.svd(jacobian, compute_uv=False)
    figures = Observability.of(jacobian.T @ jacobian)
    assert figures.condition == pytest.approx(np.linalg.cond(jacobian))
    assert figures.index == pytest.approx(np.prod(singular) ** 0.2)
    assert figures.smallest == pytest.approx(singular[-1])
    assert figures.noise == pytest.approx(singular[-1] ** 2 / singular[0])
    assert figures.trace == pytest.approx(np.sum(jacobian**2))
    assert Observability.of(np.diag([1.0, 0.0])).condition == np.inf


@pytest.mark.parametrize("n", [3, 6, 7])
@pytest.mark.parametrize("criterion", CONCAVE)
def test_continuous_optimum_is_certified(criterion: Criterion, n: int) -> None:
    candidates = Candidates(_matrices(n, 500, n))
    optimum = continuous_optimum(candidates, criterion)
    mean = candidates.mean(optimum.weights)[None]
    smooth = float(criterion.smooth(mean)[0])
    assert 0 <= optimum.bound - smooth < (2.5e-3 if criterion.name in {"D", "A", "trace"} else 0.05)
    assert optimum.weights.min() >= 0
    assert optimum.weights.sum() == pytest.approx(1)
    assert criterion.score(mean)[0] == pytest.approx(optimum.score, abs=1e-9)


@pytest.mark.parametrize("m", [1000, 10000])
def test_efficiency(m: int) -> None:
    candidates = Candidates(_matrices(1, m, 6))
    result = choose(candidates, 18)
    assert result.efficiency is not None
    assert result.efficiency >= 0.99
    assert result.score - continuous_optimum(candidates, result.criterion).bound >= np.log(0.9)
    assert len(set(result.chosen.tolist())) == 18


def test_one_of_each_group() -> None:
    candidates, group = Candidates(_matrices(2, 300, 4)), np.repeat(np.arange(30), 10)
    result = choose(candidates, 20, group=group)
    assert len(set(group[result.chosen])) == 20
    assert result.efficiency is not None
    assert 0.98 < result.efficiency <= 1
    more = extend(candidates, result.chosen, 10, group=group)
    assert sorted(group[np.concatenate([result.chosen, more])]) == list(range(30))


def test_extension_takes_the_best_first() -> None:
    matrices = _matrices(3, 100, 3)
    candidates = Candidates(matrices)
    chosen = choose(candidates, 5).chosen
    more = extend(candidates, chosen, 1, group=np.arange(100))
    values = [np.linalg.slogdet(matrices[chosen].sum(0) + x)[1] for i, x in enumerate(matrices) if i not in chosen]
    assert np.linalg.slogdet(matrices[chosen].sum(0) + matrices[more[0]])[1] == pytest.approx(max(values))


@pytest.mark.parametrize("criterion", ALL)
def test_exchange_scores_and_rate(criterion: Criterion) -> None:
    candidates = Candidates(_matrices(4, 40, 4))
    scores = exchange_scores(candidates, criterion, np.arange(8), np.array([20, 30]))
    swapped = np.array([0, 1, 2, 30, 4, 5, 6, 7])
    wanted = _score(criterion, candidates, swapped)
    assert scores[3, 1] == pytest.approx(wanted)
    assert rated(candidates, swapped, choose(candidates, 8, criterion=criterion)).score == pytest.approx(wanted)


def test_what_cannot_be_determined_is_said() -> None:
    matrices = _matrices(5, 50, 4)
    matrices[:, 3] = matrices[:, :, 3] = 0
    with pytest.raises(ValueError, match="do not determine"):
        choose(Candidates(matrices), 10)
    with pytest.raises(ValueError, match="expected at least 60"):
        choose(Candidates(_matrices(5, 50, 4)), 60)
