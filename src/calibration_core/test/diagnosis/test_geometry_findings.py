"""One joint's geometry that stands out of the others' is named; geometry that is off throughout is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from absolute_cases import make_cell, make_readings, random_angles, truth_of

from calibration_core.diagnosis.findings.geometry import Corrections, hypotheses_of, judged
from calibration_core.diagnosis.positions import diagnose_still
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.model.effects.candidate import typical

POINTS = ("mp1", "mp2", "mp3")
JOINTS = tuple(f"joint_{k + 1}" for k in range(6))
RATED_LOAD = 100.0
TURNED = np.array([0.0, 0.0, 0.0, 1.2e-3, -0.9e-3, 0.0])  # m, rad


def diagnosed(joint: int | None, throughout: float, seed: int = 5) -> Diagnosis:
    """Diagnose a robot whose frames are all off by `throughout` (m and rad), and one of them by more."""
    cell = make_cell(points=POINTS)
    truth = truth_of(cell, seed, geometry=throughout)
    if joint is not None:
        geometry = truth.geometry.copy()
        geometry[joint] += TURNED
        truth = truth.replace(geometry=geometry)
    return diagnose_still(make_readings(cell, truth, random_angles(seed, 60, 6)), cell)


def test_a_turned_frame_is_named_with_its_size() -> None:
    found = diagnosed(2, 1e-4)
    assert [(f.effect, f.location["joint"]) for f in found.findings] == [("geometry_error", "joint_3")]
    finding = found.findings[0]
    values = {p.name: p for p in finding.parameters}
    assert abs(values["rx"].value - TURNED[3]) < 4 * values["rx"].std
    assert abs(values["ry"].value - TURNED[4]) < 4 * values["ry"].std
    assert finding.magnitude > 2e-4
    assert finding.held_out_gain > 0.5
    assert found.verdict == "missing_physics"


def test_geometry_that_is_as_wrong_everywhere_is_refitted_and_no_finding() -> None:
    assert diagnosed(None, 1e-3).findings == ()


def corrections(value: np.ndarray) -> Corrections:
    """Return corrections of which every one answers to errors of neighbouring frames, as real ones do."""
    answer = np.eye(24, 36, 6) + 0.3 * np.eye(24, 36, 9)
    return Corrections(value, 1e-10 * np.eye(24), answer, np.zeros((3, 36)), RATED_LOAD)


@pytest.mark.parametrize("level", [pytest.param(0.7, marks=pytest.mark.slow), 5.0])
def test_false_alarms_are_rare_however_well_the_cell_is_set_up(level: float) -> None:
    rng = np.random.default_rng(3)
    hypotheses = hypotheses_of(JOINTS, RATED_LOAD)
    usual = np.repeat(
        [typical("registration_geometry_length", RATED_LOAD), typical("registration_geometry_angle", RATED_LOAD)], 3
    )
    blank = corrections(np.zeros(24))
    alarms = 0
    for _ in range(30):
        errors = level * np.tile(usual, 6) * rng.standard_normal(36)
        scores, limit = judged(dataclasses.replace(blank, value=blank.answer @ errors), hypotheses, ())
        alarms += bool(scores.max() > limit)
    assert alarms <= 2  # three or more of thirty at one percent: chance 0.003
