"""A window is settled or not, or settles on the way."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.observations.window import line_drift, settled_from

TIME = np.arange(200) * 10_000_000
TOLERANCE = np.full(3, 6e-5)
noise = np.random.default_rng(0).normal(size=(200, 3)) * 1e-5


def test_settled() -> None:
    assert settled_from(TIME, noise, TOLERANCE) == 0


@pytest.mark.parametrize("rise", [1e-4, -1e-3])
def test_a_ramp_never_settles(rise: float) -> None:
    values = noise + np.linspace(0, 2 * rise, 200)[:, None] * [0, 1, 0]
    assert settled_from(TIME, values, TOLERANCE) is None


def test_a_small_or_insignificant_drift_is_settled() -> None:
    assert settled_from(TIME, noise + np.linspace(0, 5e-5, 200)[:, None], TOLERANCE) == 0
    loud = noise * 100 + np.linspace(0, 1e-4, 200)[:, None]
    assert settled_from(TIME, loud, TOLERANCE) == 0


def test_the_beginning_is_given_up() -> None:
    values = noise + 1e-3 * np.exp(-np.arange(200) / 15.0)[:, None]
    assert settled_from(TIME, values, TOLERANCE) in (50, 100)


def test_few_samples_are_taken_as_they_are() -> None:
    assert settled_from(TIME[:5], np.linspace(0, 1, 5)[:, None], np.array([1e-6])) == 0
    assert settled_from(TIME[:0], np.empty((0, 1)), np.array([1e-6])) == 0


def test_drift_and_its_error() -> None:
    rng = np.random.default_rng(1)
    drifts, errors = zip(
        *(line_drift(TIME, (np.linspace(0, 3.0, 200) + rng.normal(size=200))[:, None]) for _ in range(300)), strict=True
    )
    assert np.mean(drifts) == pytest.approx(3.0, abs=0.05)
    assert np.mean(errors) == pytest.approx(np.std(drifts), rel=0.15)


def test_equal_times_have_no_drift() -> None:
    drift, error = line_drift(np.zeros(10, np.int64), np.arange(10.0)[:, None])
    assert (drift[0], error[0]) == (0.0, 0.0)
