"""Stiffness intervals where the place or the form of a part that gives way is open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from robots import STIFFNESS
from several_cases import measured, setup

from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.model.parameters import AppliedEffect

TRUE = 1 / np.array(STIFFNESS)


def test_beside_postures_at_rest_the_truth_is_held_whatever_axes_a_bearing_tilts_about(tmp_path: Path) -> None:
    """One size explains the recording; in truth there are two, and one of them turns as the joint before does."""
    cell = setup(tmp_path, 0)
    sizes = {"compliance_x": 0.18 * TRUE[5], "compliance_y": 0.117 * TRUE[5], "compliance_xy": 0.0}
    tilts = AppliedEffect("off_axis_compliance", {"joint": "joint_6"}, "before", sizes)
    answer = diagnose(measured(cell, 0, 7, configurations=8, rest=14, effects=(tilts,)), cell)
    assert [(one.effect, one.location, one.variant) for one in answer.findings] == [
        ("off_axis_compliance", {"joint": "joint_6"}, "isotropic")
    ]
    assert answer.compliance is not None
    assert answer.compliance_covariance is not None
    off = (answer.compliance - TRUE) / np.sqrt(np.diag(answer.compliance_covariance))
    assert np.abs(off).max() < 2.5
