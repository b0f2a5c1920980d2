"""The residuals are called more than noise when they are, and only then."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.identification.result.estimate import Identification, NoiseCheck
from calibration_core.identification.statistics import SIGNIFICANT
from calibration_core.report.results.verdict import rest


def with_noise(answer: Identification, seen: float, *checks: NoiseCheck, freedom: int = 1272) -> Identification:
    noise = dataclasses.replace(answer.noise, checks=(NoiseCheck("residual", seen, freedom), *checks))
    return dataclasses.replace(answer, noise=noise)


def test_noise_is_no_rest(loaded: Identification) -> None:
    left = rest(with_noise(loaded, 2.03e-5))
    assert not left.significant
    assert left.configurations == ()
    assert left.axis == ""


def test_a_rest_is_found_with_its_size_and_place(loaded: Identification) -> None:
    residual = np.array(loaded.residuals.residual)
    residual[loaded.readings.configuration == 7, 2] += 3e-4
    worse = dataclasses.replace(loaded, residuals=dataclasses.replace(loaded.residuals, residual=residual))
    left = rest(with_noise(worse, 5e-5))
    assert left.significant
    assert left.rms == pytest.approx(np.sqrt(5e-5**2 - 2e-5**2))
    assert left.configurations[0] == 7
    assert left.axis == "z"


def test_noise_seen_without_the_model_is_no_missing_physics(loaded: Identification) -> None:
    left = rest(with_noise(loaded, 5e-5, NoiseCheck("rigid triangle", 5.1e-5, 486)))
    assert not left.significant
    assert left.source == "rigid triangle"


def test_a_robot_that_does_not_return_is_no_noise(loaded: Identification) -> None:
    assert rest(with_noise(loaded, 5e-5, NoiseCheck("zero return", 5.1e-5, 162))).significant


def test_few_readings_cannot_prove_a_rest(loaded: Identification) -> None:
    assert not rest(with_noise(loaded, 2.4e-5, freedom=4)).significant


def test_many_readings_do_not_make_a_trifle_matter(loaded: Identification) -> None:
    assert not rest(with_noise(loaded, 2.04e-5, freedom=10_000_000)).significant


@pytest.mark.parametrize("freedom", [30, 300])
def test_false_alarms_are_as_rare_as_stated(loaded: Identification, freedom: int) -> None:
    rng = np.random.default_rng(freedom)
    seen = 2e-5 * np.sqrt(rng.chisquare(freedom, 2000) / freedom)
    alarms = sum(rest(with_noise(loaded, float(s), freedom=freedom)).significant for s in seen)
    assert alarms <= 2000 * SIGNIFICANT + 3 * np.sqrt(2000 * SIGNIFICANT)


def test_any_residual_exceeds_a_claim_of_no_noise(loaded: Identification) -> None:
    noise = dataclasses.replace(loaded.noise, claimed=0.0, checks=())
    assert rest(dataclasses.replace(loaded, noise=noise)).significant
