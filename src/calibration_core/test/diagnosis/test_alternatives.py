"""Stiffness intervals where the place or the form of a part that gives way is open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from robots import STIFFNESS
from several_cases import measured, setup

from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.model.parameters import AppliedEffect

TRUE = 1 / np.array(STIFFNESS)


def off(answer: Diagnosis) -> np.ndarray:
    """Return how far compliances are from the truth, (n,) standard deviations."""
    assert answer.compliance is not None
    assert answer.compliance_covariance is not None
    return np.asarray((answer.compliance - TRUE) / np.sqrt(np.diag(answer.compliance_covariance)))


def test_beside_postures_at_rest_the_truth_is_held_whatever_axes_a_bearing_tilts_about(tmp_path: Path) -> None:
    """One size explains the recording; in truth there are two, and one of them turns as the joint before does."""
    cell = setup(tmp_path, 0)
    sizes = {"compliance_x": 0.18 * TRUE[5], "compliance_y": 0.117 * TRUE[5], "compliance_xy": 0.0}
    tilts = AppliedEffect("off_axis_compliance", {"joint": "joint_6"}, "before", sizes)
    answer = diagnose(measured(cell, 0, 7, configurations=8, rest=14, effects=(tilts,)), cell)
    assert [(one.effect, one.location, one.variant) for one in answer.findings] == [
        ("off_axis_compliance", {"joint": "joint_6"}, "isotropic")
    ]
    assert np.abs(off(answer)).max() < 2.5


def test_a_base_that_rocks_is_listed_beside_the_bearing_that_tilts_alike_and_may_turn_with_joint_1(
    tmp_path: Path,
) -> None:
    """Where a bearing is named, joint 1 alone turns about its axis; where it is the base, the base turns with it."""
    cell = setup(tmp_path, 0)
    sizes = {
        "rotation_x": 0.14 * TRUE[0],
        "rotation_y": 0.14 * TRUE[0],
        "rotation_xy": 0.0,
        "rotation_z": 0.05 * TRUE[0],
    }
    base = AppliedEffect("base_compliance", {"base": "base"}, "rotation", sizes)
    answer = diagnose(measured(cell, 0, 7, configurations=8, rest=14, effects=(base,)), cell)
    (finding,) = answer.findings
    places = {(one.effect, *one.location.values()) for one in (finding, *finding.cannot_be_told_from)}
    assert {("base_compliance", "base"), ("off_axis_compliance", "joint_1")} <= places
    assert np.abs(off(answer)).max() < 2.5
