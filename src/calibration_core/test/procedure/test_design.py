"""The choice is good, the bound holds, and groups are respected."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from calibration_core.procedure.design import choose, exchange_values, extend, rated
from calibration_core.procedure.optimum import continuous_optimum


def _matrices(seed: int, m: int, n: int, rows: int = 3) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(m, rows, n)) * np.geomspace(1, 1e-4, n)
    return a.transpose(0, 2, 1) @ a


def _log_det(matrices: np.ndarray, chosen: np.ndarray) -> float:
    return float(np.linalg.slogdet(matrices[chosen].mean(axis=0))[1])


@pytest.mark.parametrize("seed", range(5))
def test_best_of_all_choices_never_exceeds_the_bound(seed: int) -> None:
    matrices = _matrices(seed, 12, 3)
    values = [_log_det(matrices, np.array(chosen)) for chosen in combinations(range(12), 4)]
    result = choose(matrices, 4)
    assert max(values) <= result.bound <= result.continuous_bound
    assert result.log_det == pytest.approx(max(values), abs=1e-9)  # small enough for the exchange to find the best
    assert result.log_det == pytest.approx(_log_det(matrices, result.chosen), abs=1e-9)


@pytest.mark.parametrize("n", [3, 6, 7])
def test_continuous_optimum_is_certified(n: int) -> None:
    matrices = _matrices(n, 500, n)
    optimum = continuous_optimum(matrices)
    assert 0 <= optimum.bound - optimum.log_det < n * 2.5e-3
    assert optimum.weights.min() >= 0
    assert optimum.weights.sum() == pytest.approx(1)
    mean = np.einsum("m,mij->ij", optimum.weights, matrices)
    assert np.linalg.slogdet(mean)[1] == pytest.approx(optimum.log_det, abs=1e-6)


@pytest.mark.parametrize("m", [1000, 10000])
def test_efficiency(m: int) -> None:
    result = choose(_matrices(1, m, 6), 18)
    assert result.efficiency >= 0.99
    assert result.continuous_efficiency >= 0.9
    assert len(set(result.chosen.tolist())) == 18


def test_one_of_each_group() -> None:
    matrices, group = _matrices(2, 300, 4), np.repeat(np.arange(30), 10)
    result = choose(matrices, 20, group=group)
    assert len(set(group[result.chosen])) == 20
    assert 0.98 < result.efficiency <= 1
    more = extend(matrices, result.chosen, 10, group=group)
    assert sorted(group[np.concatenate([result.chosen, more])]) == list(range(30))


def test_extension_takes_the_best_first() -> None:
    matrices = _matrices(3, 100, 3)
    chosen = choose(matrices, 5).chosen
    more = extend(matrices, chosen, 1, group=np.arange(100))
    values = [np.linalg.slogdet(matrices[chosen].sum(0) + x)[1] for i, x in enumerate(matrices) if i not in chosen]
    assert np.linalg.slogdet(matrices[chosen].sum(0) + matrices[more[0]])[1] == pytest.approx(max(values))


def test_exchange_values_and_rate() -> None:
    matrices = _matrices(4, 40, 4)
    chosen, rows = np.arange(8), np.array([20, 30])
    values = exchange_values(matrices, chosen, rows)
    swapped = np.array([0, 1, 2, 30, 4, 5, 6, 7])
    assert values[3, 1] == pytest.approx(_log_det(matrices, swapped))
    assert rated(matrices, swapped, choose(matrices, 8)).log_det == pytest.approx(_log_det(matrices, swapped))


def test_what_cannot_be_determined_is_said() -> None:
    matrices = _matrices(5, 50, 4)
    matrices[:, 3] = matrices[:, :, 3] = 0
    with pytest.raises(ValueError, match="do not determine"):
        choose(matrices, 10)
    with pytest.raises(ValueError, match="expected at least 60"):
        choose(_matrices(5, 50, 4), 60)
