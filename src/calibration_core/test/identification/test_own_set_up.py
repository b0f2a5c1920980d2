"""A model of the robot from another set-up: what belongs to the robot is taken from it, frames from the cell file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS
from several_cases import measured, setup, truth_in

from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.end_effector import in_own_set_up
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.parameters import AppliedEffect

SIZES = {"compliance_x": 6e-8, "compliance_y": 5e-8, "compliance_xy": 1e-8}  # rad/(N*m)
TILT = AppliedEffect("off_axis_compliance", {"joint": "joint_2"}, "before", SIZES)


@pytest.mark.parametrize("points", ["absolute", "displacement"])
def test_what_was_found_in_one_set_up_is_not_found_again_in_another(points: str, tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, points, sigma=2e-5) for k in range(2)]
    found = truth_in(cells[0], 3, STIFFNESS, np.zeros((6, 6))).replace(effects=(TILT,))
    given = GivenModel(found, "model.yaml", "")
    later = measured(cells[1], 1, 41, effects=(TILT,))
    diagnosed = diagnose(later, cells[1], given=given)
    assert "off_axis_compliance" not in {one.effect for one in diagnosed.findings}
    assert not any("the given model" in one.explanation for one in diagnosed.findings)
    assert not diagnosed.rest.significant
    identified = identify(later, cells[1], given=given)
    z = [(joint.value - true) / joint.std for joint, true in zip(identified.stiffness, STIFFNESS, strict=True)]
    assert np.abs(z).max() < 3.5


def test_in_its_own_set_up_a_model_keeps_its_frames(tmp_path: Path) -> None:
    cell = setup(tmp_path, 0, sigma=2e-5)
    recording = measured(cell, 0, 40)
    given = GivenModel(identify(recording, cell).model, "model.yaml", "")
    assert in_own_set_up(given, recording, cell) is given
    frames = cell.frames.model_copy(update={"tracker": None})
    assert in_own_set_up(given, recording, cell.model_copy(update={"frames": frames})) is given
