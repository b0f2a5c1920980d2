"""A residual beyond the noise is never called noise, and it is said where it is largest."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calibration_core.diagnosis.data_checks.adequacy import against_noise

NOISE = 1e-5  # m
PER = {7: 1.0e-5, 3: 4.0e-5, 12: 1.2e-5, 5: 2.0e-5}


@pytest.mark.parametrize("noise_freedom", [200.0, math.inf])
@pytest.mark.parametrize("times", [1.6, 3.0, 10.0])
def test_a_residual_larger_than_the_noise_is_significant(times: float, noise_freedom: float) -> None:
    rest = against_noise(times * NOISE, 500.0, NOISE, noise_freedom, PER)
    assert rest.significant
    assert rest.rms == pytest.approx(NOISE * np.sqrt(times**2 - 1), rel=1e-9)
    assert list(rest.where["configurations"])[:2] == [3, 5]
    assert rest.where["times_noise"][0] == 4.0
    assert "3, 5" in rest.text
    assert rest.verdict(found=True) == "partly_explained"
    assert rest.verdict(found=False) == "unexplained"


@pytest.mark.parametrize("noise_freedom", [200.0, math.inf])
@pytest.mark.parametrize("times", [0.5, 1.0])
def test_a_residual_of_the_size_of_the_noise_is_noise(times: float, noise_freedom: float) -> None:
    rest = against_noise(times * NOISE, 500.0, NOISE, noise_freedom, PER)
    assert not rest.significant
    assert rest.where == {}
    assert rest.verdict(found=True) == "missing_physics"
    assert rest.verdict(found=False) == "consistent"


def test_what_few_readings_show_is_less_sure() -> None:
    """Twice the noise: no chance with 500 degrees of freedom of either, and a chance with three of each."""
    assert against_noise(2 * NOISE, 500.0, NOISE, 500.0, PER).significant
    assert not against_noise(2 * NOISE, 3.0, NOISE, 3.0, PER).significant
