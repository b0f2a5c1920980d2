"""Elasticity is claimed where gravity bends the robot, and not where something else looks like it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from absolute_cases import ELBOW, POINTS, SEVEN, SIGMA, make_cell, make_readings, random_angles, truth_of

from calibration_core.cell import Cell
from calibration_core.commands.evaluation.identify import Identified, evaluate
from calibration_core.identification.absolute.evaluate import identify_absolute
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.timeseries import Readings

COUNT = 150


def _stage(result: Identification, name: str = "elasticity"):
    return next(stage for stage in result.stages if stage.name == name)


def _soft(cell: Cell, compliance: list[float]) -> Readings:
    truth = truth_of(cell, 1).replace(compliance=np.array(compliance))
    return make_readings(cell, truth, random_angles(3, COUNT, len(compliance)))


@pytest.mark.parametrize(
    ("rows", "compliance"),
    [(ELBOW, [0, 4e-7, 6e-7, 0, 0, 0]), (SEVEN, [0, 5e-7, 0, 6e-7, 0, 0, 0])],
    ids=["6 joints", "7 joints"],
)
def test_springs_are_found_with_honest_intervals(rows: tuple, compliance: list[float]) -> None:
    cell = make_cell(rows)
    result = identify_absolute(_soft(cell, compliance), cell)
    assert _stage(result).kept, _stage(result).reason
    for entry, true in zip(result.stiffness, compliance, strict=True):
        if true > 0:
            assert entry.identifiable
            assert abs(entry.compliance - true) < 4 * entry.compliance_std
            assert entry.compliance_std < 0.2 * true
        elif not entry.identifiable:
            assert "not fitted" in entry.reason or "zero" in entry.reason or "hardly" in entry.reason
    assert "gravity turned by 90 degrees" in _stage(result).reason


@pytest.mark.parametrize("count", [24, 30])
def test_springs_that_hide_the_geometry_are_found_together_with_it(count: int) -> None:
    """Large sag and small errors of the geometry: neither gains clearly without the other."""
    cell = make_cell(ELBOW, tuple(POINTS))
    truth = truth_of(cell, 1, geometry=1e-4).replace(compliance=np.array([0, 8e-7, 9e-7, 0, 0, 0]))
    result = identify_absolute(make_readings(cell, truth, random_angles(21, count, 6)), cell)
    assert _stage(result, "geometry").kept
    assert "; with elasticity on both sides; kept" in _stage(result, "geometry").reason
    assert _stage(result).kept
    assert result.fit.rms_after < 1.05 * SIGMA
    for joint in (1, 2):
        entry = result.stiffness[joint]
        assert abs(entry.compliance - truth.compliance[joint]) < 3 * entry.compliance_std


@pytest.mark.parametrize(("seed", "noted"), [(0, False), (2, True)])
def test_a_residual_that_unproven_parameters_would_explain_is_stated(seed: int, noted: bool) -> None:
    """Few postures of a robot a fifth softer than stated: nothing is missing, and the fit is proven or is not."""
    stated = [2e6, 1.25e6, 1.1e6, 5e5, 4e5, 3e5]
    cell = make_cell(ELBOW, tuple(POINTS), robot={"stiffness": stated})
    truth = truth_of(cell, seed, geometry=1e-4).replace(compliance=1.2 / np.array(stated))
    answer = evaluate(make_readings(cell, truth, random_angles(seed + 20, 14, 6)), cell, Options())
    assert isinstance(answer, Identified)
    texts = [note["text"] for note in answer.content["notes"] if note["kind"] == "unproven"]
    assert answer.content["verdict"] == "consistent"
    assert (answer.content["fit"]["rms_after"] > 10 * SIGMA) is noted
    assert [text.startswith("it leaves 468 µm per coordinate, the noise is 21 µm") for text in texts] == [True] * noted
    assert ("the identified model leaves 468 µm per coordinate" in answer.content["reason"]) is noted
    assert not noted or answer.content["usable"] == "with_reservations"


def test_a_rigid_robot_claims_nothing() -> None:
    cell = make_cell()
    result = identify_absolute(_soft(cell, [0.0] * 6), cell)
    assert not _stage(result).kept
    assert result.stiffness == ()
    assert not result.model.compliance.any()
    assert _stage(result, "geometry").kept


def test_a_harmonic_of_the_transmission_is_no_elasticity() -> None:
    cell = make_cell()
    q = random_angles(3, COUNT, 6)
    turned = q.copy()
    turned[:, 1] += 2e-4 * np.sin(q[:, 1] + 0.4)
    readings = make_readings(cell, truth_of(cell, 1), turned)
    result = identify_absolute(dataclasses.replace(readings, q=q), cell)
    assert not _stage(result).kept, _stage(result).reason
    assert result.stiffness == ()


def test_a_pull_that_does_not_come_from_gravity_is_no_elasticity() -> None:
    cell = make_cell()
    sideways = make_cell(robot={"gravity": [9.80665, 0.0, 0.0]})
    truth = truth_of(cell, 1).replace(compliance=np.array([0, 6e-7, 9e-7, 0, 0, 0]))
    readings = make_readings(sideways, truth, random_angles(3, COUNT, 6))
    result = identify_absolute(readings, cell)
    assert not _stage(result).kept, _stage(result).reason


def test_without_masses_it_is_not_tried() -> None:
    cell = make_cell(masses=False)
    result = identify_absolute(make_readings(cell, truth_of(cell, 1), random_angles(3, 60, 6)), cell)
    assert not _stage(result).kept
    assert "states no inertials" in _stage(result).reason
    assert result.fit.rms_after < 1.1 * SIGMA
