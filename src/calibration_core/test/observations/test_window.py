"""Averages over a settled window of a stream that is still arriving."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.observations.average import average
from calibration_core.observations.window import Averaging, SettledWindow, Waiting

MS = 1_000_000
START = 1_700_000_000_000_000_000
TOLERANCE = np.full(3, 3e-5)


def feed(averaging: Averaging, values: np.ndarray, first: int = 0) -> SettledWindow | Waiting:
    for k, one in enumerate(values):
        averaging.add(START + 10 * MS * (first + k), one)
    return averaging.state()


def test_the_mean_is_that_of_the_window() -> None:
    values = 1e-5 * np.random.default_rng(1).standard_normal((301, 3))
    state = feed(Averaging(START, 1.0, TOLERANCE, 20), values)
    assert isinstance(state, SettledWindow)
    expected = average(values[-101:])
    assert (state.begin, state.end) == (START + 2000 * MS, START + 3000 * MS)
    np.testing.assert_array_equal(state.average.mean, expected.mean)
    np.testing.assert_array_equal(state.average.covariance, expected.covariance)


def test_it_waits_for_a_full_window_and_enough_samples() -> None:
    values = 1e-5 * np.random.default_rng(2).standard_normal((101, 3))
    state = feed(Averaging(START, 1.0, TOLERANCE, 20), values[:51])
    assert isinstance(state, Waiting)
    assert (state.share, state.samples, state.moving) == (0.5, 51, False)
    state = feed(Averaging(START, 1.0, TOLERANCE, 1000), values)
    assert isinstance(state, Waiting)
    assert state.samples == 101
    assert isinstance(Averaging(START, 1.0, TOLERANCE, 20).state(), Waiting)


def test_samples_before_the_start_do_not_count() -> None:
    values = 1e-5 * np.random.default_rng(3).standard_normal((120, 3))
    state = feed(Averaging(START + 500 * MS, 1.0, TOLERANCE, 20), values)
    assert isinstance(state, Waiting)
    assert state.samples == 70


def test_it_waits_while_the_window_moves_and_slides_on() -> None:
    rng = np.random.default_rng(4)
    time = 0.01 * np.arange(600)
    decay = 1e-3 * np.exp(-time / 0.3)
    values = np.column_stack([decay, decay, decay]) + 1e-6 * rng.standard_normal((600, 3))
    averaging = Averaging(START, 1.0, TOLERANCE, 20)
    state = feed(averaging, values[:110])
    assert isinstance(state, Waiting)
    assert state.moving
    state = feed(averaging, values[110:], first=110)
    assert isinstance(state, SettledWindow)
    assert np.abs(state.average.mean).max() < 3e-6


def test_no_average_across_a_gap() -> None:
    values = 1e-5 * np.random.default_rng(5).standard_normal((160, 3))
    averaging = Averaging(START, 1.0, TOLERANCE, 20)
    feed(averaging, values[:80])
    averaging.break_off()
    state = feed(averaging, values[80:], first=90)
    assert isinstance(state, Waiting)
    assert state.samples == 80


@pytest.mark.parametrize("window", [0.3, 2.0])
def test_memory_is_bounded_by_the_window(window: float) -> None:
    averaging = Averaging(START, window, TOLERANCE, 1)
    state = feed(averaging, np.random.default_rng(6).standard_normal((2000, 3)))
    assert isinstance(state, SettledWindow)
    assert state.average.samples + state.average.outliers <= window / 0.01 + 2
