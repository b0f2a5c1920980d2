"""Known truths are drawn, estimated from estimates alone, and recovered."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration_core.fleet.pooling import LEAST, Population, pool, posterior

CRITICAL = 3.9
PLANTS = 40
ROBOTS = 100
OUTLIERS = 0.04


def plant(rng: np.random.Generator, spread: float) -> tuple[NDArray[np.float64], ...]:
    """Truth, measured values, their standard deviations, and which robots do not belong."""
    std = np.exp(rng.normal(np.log(0.015), 0.4, ROBOTS))
    odd = rng.random(ROBOTS) < OUTLIERS
    truth = 13.0 + spread * rng.standard_normal(ROBOTS)
    truth[odd] += rng.choice([-1, 1], odd.sum()) * rng.uniform(0.15, 0.4, odd.sum())
    return truth, truth + std * rng.standard_normal(ROBOTS), std, odd


@pytest.mark.parametrize("spread", [0.01, 0.05, 0.15])
def test_intervals_of_95_percent_cover_95_percent(spread: float) -> None:
    rng = np.random.default_rng(20)
    inside, odd_ones, errors = [], [], []
    for _ in range(PLANTS):
        truth, value, std, odd = plant(rng, spread)
        found = pool(value, std, CRITICAL)
        assert found is not None
        inside.append((found.low <= truth) & (truth <= found.high))
        odd_ones.append(odd)
        errors.append([np.abs(found.value - truth)[~odd].mean(), np.abs(value - truth)[~odd].mean()])
    covered, odd = np.concatenate(inside), np.concatenate(odd_ones)
    assert 0.93 <= covered.mean() <= 0.97
    assert 0.90 <= covered[odd].mean() <= 0.99
    pooled, raw = np.mean(errors, axis=0)
    assert pooled <= raw * (0.75 if spread == 0.01 else 1.0)


def test_a_robot_that_is_far_off_is_neither_moved_nor_used() -> None:
    rng = np.random.default_rng(3)
    value = 13.0 + 0.03 * rng.standard_normal(60)
    std = np.full(60, 0.01)
    without = pool(value, std, CRITICAL)
    value[7] -= 0.4
    found = pool(value, std, CRITICAL)
    assert without is not None
    assert found is not None
    assert np.flatnonzero(~found.belongs).tolist() == [7]
    assert found.value[7] == value[7]
    assert found.deviation[7] < -CRITICAL
    assert found.population.mean == pytest.approx(without.population.mean, abs=0.003)
    assert found.population.spread == pytest.approx(0.03, rel=0.25)


def test_pooling_can_be_refused() -> None:
    rng = np.random.default_rng(4)
    value, std = 13.0 + 0.02 * rng.standard_normal(30), np.full(30, 0.02)
    refused = np.arange(30) == 4
    found = pool(value, std, CRITICAL, refused)
    assert found is not None
    assert found.value[4] == value[4]
    assert found.std[4] == std[4]
    assert np.all(found.value[~refused] != value[~refused])


def test_few_robots_are_no_population() -> None:
    assert pool(np.full(LEAST - 1, 13.0), np.full(LEAST - 1, 0.01), CRITICAL) is None


@pytest.mark.parametrize("robots", [6, 12, 100])
def test_few_robots_accuse_nobody(robots: int) -> None:
    rng = np.random.default_rng(9)
    accused = 0
    for _ in range(400):
        value = 13.0 + 0.03 * rng.standard_normal(robots)
        found = pool(value + 0.01 * rng.standard_normal(robots), np.full(robots, 0.01), CRITICAL, judge_only=True)
        accused += 0 if found is None else int(np.count_nonzero(~found.belongs))
    assert accused / (400 * robots) <= 0.001


def test_alike_robots_share_their_measurements() -> None:
    """Without a spread, the pooled value is the mean, and known nearly as well as the mean."""
    rng = np.random.default_rng(5)
    value, std = 13.0 + 0.02 * rng.standard_normal(200), np.full(200, 0.02)
    found = pool(value, std, CRITICAL)
    assert found is not None
    assert np.std(found.value) < 0.4 * np.std(value)


@pytest.mark.parametrize("spread", [0.01, 0.05, 0.15])
def test_the_estimated_population_serves_as_well_as_the_true_one(spread: float) -> None:
    """Six configurations with it; where robots differ little, as good as eighteen configurations alone."""
    rng = np.random.default_rng(6)
    eighteen = 0.02
    six = eighteen * np.sqrt(3.0)
    errors: list[list[float]] = []
    for _ in range(PLANTS):
        known = 13.0 + spread * rng.standard_normal(ROBOTS)
        found = pool(known + eighteen * rng.standard_normal(ROBOTS), np.full(ROBOTS, eighteen), CRITICAL)
        assert found is not None
        new = 13.0 + spread * rng.standard_normal(ROBOTS)
        short, std = new + six * rng.standard_normal(ROBOTS), np.full(ROBOTS, six)
        estimated = posterior(short, std, found.population)[0]
        true = posterior(short, std, Population(13.0, spread, 1e-6, 1e-6, ROBOTS))[0]
        long = new + eighteen * rng.standard_normal(ROBOTS)
        errors.append([np.abs(one - new).mean() for one in (estimated, true, long)])
    estimated_error, true_error, long_error = np.mean(errors, axis=0)
    assert estimated_error <= 1.1 * true_error
    if spread <= 1.4 * eighteen:
        assert estimated_error <= 1.1 * long_error
