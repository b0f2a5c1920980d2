"""The MuJoCo model is read again and compared, as every format is; MuJoCo itself shows what its springs do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_cases import CELLS, UR_ROWS, case, write_cell

from calibration_core.formats import mjcf
from calibration_core.formats.calibrated import calibrated_robot
from calibration_core.formats.mjcf import mjcf_files
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect

SPRINGS = (
    AppliedEffect("off_axis_compliance", {"joint": "joint_2"}, "linear", {"compliance_x": 1e-7, "compliance_y": 2e-7}),
)


def cell_of(kind: str, folder: Path) -> Path:
    if kind == "six":
        return CELLS / "small.cell.yaml"
    rows = [(0.0, -np.pi / 2, 0.1), *UR_ROWS]
    types = ["prismatic" if kind == "rail" else "revolute", *["revolute"] * 6]
    return write_cell(folder, kind, rows, joint_types=types)


@pytest.mark.parametrize("kind", ["six", "rail", "seven"])
def test_what_is_written_is_compared(kind: str, tmp_path: Path) -> None:
    of = case(tmp_path, cell_of(kind, tmp_path))
    (compared,) = of.export(tmp_path / "out", "--format", "mjcf")["deviations"]
    assert compared["what"] == "flange poses of robot.xml, its springs unloaded,"
    assert compared["postures"] == 1000
    assert compared["largest"] < 1e-9


def test_bodies_of_further_springs_do_not_move_the_flange(tmp_path: Path) -> None:
    of = case(tmp_path, CELLS / "small.cell.yaml")
    springs = nominal_parameters(of.cell).replace(effects=SPRINGS)
    assert mjcf_files(calibrated_robot(of.cell, springs)).deviations[0].largest < 1e-9


def test_what_is_written_wrong_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    of = case(tmp_path, CELLS / "small.cell.yaml")
    right = mjcf.joint_frames

    def wrong(chain: Any) -> Any:
        poses = right(chain).copy()
        poses[2, 0, 3] += 1e-6
        return poses

    monkeypatch.setattr(mjcf, "joint_frames", wrong)
    assert of.code(tmp_path / "out", "--format", "mjcf") != 0
    assert "differ by 1e-06 m from the model's" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
