"""What follows the standard's protocols is answered by the standard's methods, and told so in result.json."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from robots import write_cell
from test_circle_point import HOME, SIGMA, _readings, _sweeps

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.identify import identify
from calibration_core.identification.result.estimate import StandardGeometry
from calibration_core.identification.standard.kinematic_phases import standard_geometry
from calibration_core.identification.wrist import identify_wrist_centre
from calibration_core.model.chain import rpy_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.report.content import build
from calibration_core.report.results.result import result_dict
from calibration_core.report.results.standard import standard_rows


@dataclasses.dataclass(frozen=True)
class Pose:
    """A configuration without load."""

    number: int
    q: np.ndarray
    steps: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((1, 6)))


def _wrist(poses: int = 25) -> np.ndarray:
    q = np.tile(HOME, (poses, 1))
    q[:, 3:] += np.random.default_rng(6).uniform(-1.2, 1.2, (poses, 3))
    return q


def _found(cell: Cell, q: np.ndarray) -> StandardGeometry:
    found = identify(_readings(cell, chain_of(cell), q, SIGMA), cell).standard
    assert found is not None
    return found


def test_everything_from_one_recording(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    answer = identify(_readings(cell, chain_of(cell), np.concatenate([_sweeps(range(6)), _wrist()]), SIGMA), cell)
    found = answer.standard
    assert found is not None
    assert found.reasons == {}
    rows = {row.name: row for row in standard_rows(found, cell)}
    truth = nominal_parameters(cell).tracker
    pose = np.r_[truth[:3, 3], rpy_of(truth[:3, :3])]
    for name, value in zip(("x", "y", "z", "roll", "pitch", "yaw"), pose, strict=True):
        row = rows[f"tracker {name}"]
        assert abs(row.value - value) < 5 * row.std < 1e-3
    axes = [row for row in rows.values() if row.group == "joint_axes"]
    assert {row.name for row in axes} >= {"a_1", "alpha_1", "a_2", "y_3", "beta_3", "a_5", "alpha_5"}
    assert len(axes) == 18
    assert all(abs(row.value) < 5 * row.std < 1e-3 for row in axes)
    centre = [rows[f"wrist centre {axis}"] for axis in "xyz"]
    for row, value in zip(centre, (0.0, 0.0, -0.23), strict=True):
        assert abs(row.value - value) < 5 * row.std < 1e-3
    content = result_dict(answer, cell)["standard_geometry"]
    assert json.loads(json.dumps(content)) == content
    assert content["base_frame"]["parameters"][0]["value"] == rows["tracker x"].value
    assert [axis["joint"] for axis in content["joint_axes"]["axes"]] == list(cell.robot.joints)
    assert content["wrist_centre"]["points"] == "identified"
    document = build(answer, cell)
    assert "Results by circle points and spheres" in [table.caption for table in document.tables()]


def test_bending_by_weight_is_taken_off(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    q = np.concatenate([_sweeps(range(6)), _wrist()])
    poses = [Pose(number, row) for number, row in enumerate(q, start=1)]
    model = nominal_parameters(cell)
    found = identify(simulate_plan(poses, cell, model, seed=1), cell).standard
    assert found is not None
    rows = {row.name: row for row in standard_rows(found, cell)}
    errors = [rows[name].value / rows[name].std for name in rows if rows[name].group == "joint_axes"]
    assert len(errors) == 18
    assert np.abs(errors).max() < 5
    assert np.abs([rows["wrist centre x"].value, rows["wrist centre y"].value]).max() < 2e-4
    bent = standard_geometry(
        simulate_plan(poses, cell, model, seed=1), cell, model.replace(compliance=np.zeros(6)), (), np.zeros((0, 0))
    )
    errors = [row.value / row.std for row in standard_rows(bent, cell) if row.group == "joint_axes"]
    assert np.abs(errors).max() > 10


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    base = _found(cell, _sweeps(range(2)))
    assert base.base is not None
    assert (base.axes, base.wrist) == (None, None)
    assert base.reasons["joint_axes"].startswith("sweeps.csv: joint_3, joint_4, joint_5, joint_6: found no sweep")
    assert "found 0 with a wrist motion" in base.reasons["wrist_centre"]
    wrist = _found(cell, _wrist())
    assert wrist.wrist is not None
    assert (wrist.base, wrist.axes) == (None, None)
    assert wrist.reasons["base_frame"] == wrist.reasons["joint_axes"]
    assert "joint_1: found no sweep" in wrist.reasons["base_frame"]


def test_no_sweeps_leave_the_report_as_it_was(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    q = HOME + np.random.default_rng(1).uniform(-0.8, 0.8, (30, 6))
    answer = identify(_readings(cell, chain_of(cell), q, SIGMA), cell)
    assert answer.standard is not None
    assert set(answer.standard.reasons) == {"base_frame", "joint_axes", "wrist_centre"}
    assert standard_rows(answer.standard, cell) == ()
    captions = [table.caption for table in build(answer, cell).tables()]
    assert "Results by circle points and spheres" not in captions


def test_an_arm_without_a_wrist(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    short = cell.robot.model_copy(
        update={
            "joints": cell.robot.joints[:3],
            "dh": cell.robot.dh[:3],
            "joint_limits": cell.robot.joint_limits[:3],
            "inertials": None,
            "stiffness": None,
        }
    )
    with pytest.raises(IdentificationError, match="an arm that carries a wrist"):
        identify_wrist_centre(
            _readings(cell, chain_of(cell), _wrist(), SIGMA),
            cell.model_copy(update={"robot": short}),
            nominal_parameters(cell).points,
        )
