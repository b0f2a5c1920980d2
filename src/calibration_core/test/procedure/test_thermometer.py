"""The history of a thermometer: thinned, complete enough, and unharmed by a clock that was set back."""

from __future__ import annotations

import math

import numpy as np

from calibration_core.measurement.thermometer import KEPT, SILENT, SPACING, TemperatureHistory


def test_nothing_heard_is_no_temperature() -> None:
    thermometer = TemperatureHistory()
    assert math.isnan(thermometer.at(7.0))
    assert thermometer.history(7.0).shape == (0, 2)


def test_the_history_is_thinned_and_ends_with_the_newest() -> None:
    thermometer = TemperatureHistory()
    for second in range(21):
        thermometer.hear(float(second), 20.0 + 0.1 * second)
    history = thermometer.history(20.5)
    assert np.array_equal(history[:, 0], [0.0, 5.0, 10.0, 15.0, 20.0, 20.5])
    assert history[-1, 1] == thermometer.at(20.5) == 22.0


def test_what_is_not_finite_is_heard_but_not_kept() -> None:
    thermometer = TemperatureHistory()
    thermometer.hear(0.0, 20.0)
    thermometer.hear(60.0, math.nan)
    assert math.isnan(thermometer.at(60.0))
    assert np.array_equal(thermometer.history(60.0), [[0.0, 20.0], [60.0, np.nan]], equal_nan=True)


def test_a_thermometer_that_falls_silent_shows_nothing_after_a_while() -> None:
    thermometer = TemperatureHistory()
    thermometer.hear(10.0, 20.0)
    assert thermometer.at(10.0 + SILENT) == thermometer.history(10.0 + SILENT)[-1, 1] == 20.0
    assert math.isnan(thermometer.at(10.1 + SILENT))
    assert np.isnan(thermometer.history(10.1 + SILENT)[-1, 1])
    thermometer.hear(1000.0, 20.5)
    assert thermometer.at(1000.0) == 20.5


def test_a_clock_set_back_does_not_stop_the_history() -> None:
    thermometer = TemperatureHistory()
    thermometer.hear(1000.0, 20.0)
    thermometer.hear(3.0, 21.0)
    assert len(thermometer.history(3.0)) == 3


def test_the_history_is_bounded() -> None:
    thermometer = TemperatureHistory()
    for k in range(KEPT + 10):
        thermometer.hear(k * SPACING, 20.0)
    assert len(thermometer.history(0.0)) == KEPT + 1
