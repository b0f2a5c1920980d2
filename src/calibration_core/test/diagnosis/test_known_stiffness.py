"""Loads and single steps in one recording: the stiffnesses of the one tie down what the other shows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis.absolute import diagnose_absolute, prepare
from calibration_core.diagnosis.finding import Diagnosis
from calibration_core.diagnosis.known_stiffness import KnownCompliance, divided, known_compliance
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.identification.absolute import evaluate_absolute
from calibration_core.identification.predict import predict_readings
from calibration_core.model.effects import candidates
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float1D, Readings

SINE, COSINE = 1.5e-4, 7.5e-5  # rad
WAVE = AppliedEffect("transmission_error", {"joint": "joint_2"}, "order 1", {"sine": SINE, "cosine": COSINE})
RATED_LOAD = 240.0


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def loaded(cell: Cell) -> Diagnosis:
    return diagnose_loaded(loaded_readings(cell, 5), cell)


@pytest.fixture(scope="module")
def known(loaded: Diagnosis) -> KnownCompliance:
    found = known_compliance(loaded, RATED_LOAD)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def still(cell: Cell) -> Readings:
    """Single steps under the robot's own weight, with a first harmonic of joint 2 that resembles its sag."""
    readings = loaded_readings(cell, 6, 40)
    single = readings.select(readings.step == 0)
    model = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS), effects=(WAVE,))
    moved = predict_readings(single, cell, model) - predict_readings(single, cell, model.replace(effects=()))
    return dataclasses.replace(single, position=single.position + moved, wrench=None)


def test_what_loads_tell_has_a_covariance_that_holds_the_common_gain(loaded: Diagnosis, known: KnownCompliance) -> None:
    assert loaded.compliance_covariance is not None
    more = known.covariance - loaded.compliance_covariance
    assert np.allclose(more, np.outer(known.value, known.value) * 0.01**2)
    doubt = np.array([known.std(joint) for joint in known.joints])
    assert np.all(np.abs(known.value - 1 / np.array(STIFFNESS)) < 3 * doubt)
    assert np.all(doubt < 0.05 * known.value)


def test_stiffnesses_beside_a_rest_that_nothing_explains_are_not_relied_upon(loaded: Diagnosis) -> None:
    doubtful = dataclasses.replace(loaded, rest=dataclasses.replace(loaded.rest, significant=True))
    assert known_compliance(doubtful, RATED_LOAD) is None


def fitted(still: Readings, cell: Cell, known: KnownCompliance | None) -> tuple[Float1D, Float1D]:
    """Return the amplitudes of the wave and their standard deviations."""
    model = None if known is None else nominal_parameters(cell).replace(compliance=known.value)
    case = prepare(still, cell, evaluate_absolute(still, cell, believed=model), known)
    wave = next(
        c
        for c in candidates(case.state)
        if c.effect == WAVE.effect and c.variant == WAVE.variant and dict(c.location) == dict(WAVE.location)
    )
    value, covariance = case.extend((wave,)).values_of(0)
    return value, np.sqrt(np.diag(covariance))


def test_known_stiffnesses_make_the_interval_of_what_resembles_sag_narrower(
    still: Readings, cell: Cell, known: KnownCompliance
) -> None:
    _, free = fitted(still, cell, None)
    value, tied = fitted(still, cell, known)
    assert tied[0] < 0.6 * free[0]
    assert np.all(np.abs(value - [SINE, COSINE]) < 3 * tied)


def test_the_doubt_of_stiffnesses_enters_what_is_fitted_beside_them(
    still: Readings, cell: Cell, known: KnownCompliance
) -> None:
    certain = dataclasses.replace(known, covariance=1e-12 * known.covariance)
    doubted = dataclasses.replace(certain, covariance=np.diag((0.004 * known.value) ** 2))
    _, least = fitted(still, cell, certain)
    _, more = fitted(still, cell, doubted)
    assert np.all(more > least)


def test_an_effect_that_was_taken_for_sag_is_named_with_known_stiffnesses(
    still: Readings, cell: Cell, known: KnownCompliance
) -> None:
    def named(found: Diagnosis) -> set[tuple[str, str]]:
        return {(f.effect, str(f.location.get("joint"))) for f in found.findings}

    free = diagnose_absolute(still, cell)
    tied = diagnose_absolute(still, cell, known=known)
    assert (WAVE.effect, "joint_2") not in named(free)
    assert named(tied) == {(WAVE.effect, "joint_2")}


def test_only_a_stiffness_whose_doubt_shows_stays_free_and_keeps_what_is_known_as_its_prior(
    known: KnownCompliance,
) -> None:
    def sag(joint: str) -> Candidate:
        return Candidate("joint_elasticity", "absolute", {"joint": joint}, "axial", (), lambda _: np.zeros((0, 3, 0)))

    doubt = known.std("joint_2")
    free, held = divided(known, [sag("joint_2"), sag("joint_3")], [1.0 / doubt, 0.01 / known.std("joint_3")])
    assert [c.location["joint"] for c in free] == ["joint_2"]
    assert [c.location["joint"] for c in held.candidates] == ["joint_3"]
    assert np.allclose(held.covariance, [[known.std("joint_3") ** 2]])
    assert np.allclose(held.expected, known.value[known.joints.index("joint_2")])
    assert np.allclose(held.root * doubt, 1.0)


def test_a_stiffness_that_stays_free_is_fitted_with_what_loads_tell_as_its_prior(
    still: Readings, cell: Cell, known: KnownCompliance
) -> None:
    loose, tight = (dataclasses.replace(known, covariance=np.diag((by * known.value) ** 2)) for by in (10.0, 0.05))
    (first, wide), (second, narrow) = (fitted(still, cell, each) for each in (loose, tight))
    unheld, free = fitted(still, cell, None)
    assert np.allclose(first, unheld, atol=0.5 * free.min())
    assert np.allclose(wide, free, rtol=0.1)
    assert narrow[0] < 0.9 * wide[0]
    assert np.all(np.abs(second - [SINE, COSINE]) < 3 * narrow)
