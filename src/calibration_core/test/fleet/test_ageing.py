from __future__ import annotations

import math

import numpy as np
import pytest

from calibration_core.fleet.ageing import history, life

YEARS = np.arange(6) * 0.5
CRITICAL = 3.9


def measured(truth: np.ndarray, std: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return YEARS[: len(truth)], truth + std * rng.standard_normal(len(truth)), np.full(len(truth), std)


def test_nothing_happens_to_a_healthy_joint() -> None:
    found = [history(*measured(np.full(6, 13.0), 0.01, seed), CRITICAL) for seed in range(300)]
    assert sum(one.cause != "none" for one in found) <= 2
    inside = [abs(one.value - 13.0) <= 1.96 * one.std for one in found]
    assert 0.92 <= np.mean(inside) <= 0.98
    assert 0.92 <= np.mean([one.slope_interval[0] <= 0 <= one.slope_interval[1] for one in found]) <= 0.98


def test_a_collision_is_a_change_at_its_date() -> None:
    truth = np.array([13.0, 13.0, 13.0, 12.84, 12.84, 12.84])
    found = [history(*measured(truth, 0.01, seed), CRITICAL) for seed in range(50)]
    assert all(one.cause == "change" and [change.index for change in one.changes] == [3] for one in found)
    assert np.mean([one.changes[0].size for one in found]) == pytest.approx(-0.16, abs=0.003)
    assert np.mean([one.value for one in found]) == pytest.approx(12.84, abs=0.003)
    assert not any(life(one, 12.6).known for one in found)


def test_two_changes_are_two() -> None:
    truth = np.array([13.0, 13.0, 12.9, 12.9, 13.05, 13.05])
    found = history(*measured(truth, 0.005, 1), CRITICAL)
    assert [change.index for change in found.changes] == [2, 4]


def test_wear_is_a_trend_with_a_life() -> None:
    truth = 13.0 - 0.06 * YEARS
    found = [history(*measured(truth, 0.005, seed), CRITICAL) for seed in range(200)]
    assert np.mean([one.cause == "trend" for one in found]) > 0.9
    trends = [one for one in found if one.cause == "trend"]
    assert np.mean([one.slope for one in trends]) == pytest.approx(-0.06, abs=0.002)
    months = 12 * (truth[-1] - 12.7) / 0.06
    lives = [life(one, 12.7) for one in trends]
    assert all(one.known for one in lives)
    assert np.mean([one.low <= months <= one.high for one in lives]) >= 0.93
    assert np.median([one.months for one in lives]) == pytest.approx(months, rel=0.1)


@pytest.mark.parametrize("dates", [1, 2])
def test_few_dates_cannot_tell_yet(dates: int) -> None:
    found = history(YEARS[:dates], np.full(dates, 13.0), np.full(dates, 0.01), CRITICAL)
    left = life(found, 12.8)
    assert not left.known
    assert math.isinf(left.high)


def test_a_value_that_leaves_the_limit_never_reaches_it() -> None:
    found = history(*measured(13.0 + 0.06 * YEARS, 0.004, 2), CRITICAL)
    assert found.cause == "trend"
    assert math.isinf(life(found, 12.8).months)
    assert not life(found, 12.8).known


def test_three_dates_may_be_either() -> None:
    found = history(YEARS[:3], np.array([13.0, 12.97, 12.90]), np.full(3, 0.01), CRITICAL)
    assert found.cause == "change_or_trend"
