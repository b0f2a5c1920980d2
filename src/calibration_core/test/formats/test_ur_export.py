"""Universal Robots' kinematics file, rebuilt here by the published convention."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_cases import UR_KEYS, UR_LINKS, UR_ROWS, case, model_poses, template, ur, write_cell

from calibration_core.files.yaml_file import read_yaml, yaml_text
from calibration_core.formats.ur import LINKS
from calibration_core.model.chain import pose_matrix, rotation_z


def rebuilt(file: Path, q: Any) -> Any:
    rows = read_yaml(file, 1 << 16, "kinematics").data["kinematics"]
    poses = []
    for values in q:
        here = np.eye(4)
        for link, angle in zip(LINKS, values, strict=True):
            row = [rows[link][key] for key in UR_KEYS]
            turn = np.eye(4)
            turn[:3, :3] = rotation_z(angle)
            here = here @ pose_matrix(np.array(row[:3]), np.array(row[3:])) @ turn
        poses.append(here)
    return np.array(poses)


@pytest.mark.parametrize("size", [0.0, 1e-5, 1e-3])
def test_rebuilt_by_the_published_convention(size: float, tmp_path: Path) -> None:
    """Axes 2, 3 and 4 parallel, within 1e-5 rad, and not: no length runs away."""
    of = ur(tmp_path, size)
    result = of.export(tmp_path / "out", "--format", "ur", "--template", str(template(tmp_path)))
    assert result["deviations"][0]["largest"] < 1e-6
    q, expected = model_poses(of)
    assert np.abs(rebuilt(tmp_path / "out" / "kinematics.yaml", q) - expected).max() < 1e-6
    rows = read_yaml(tmp_path / "out" / "kinematics.yaml", 1 << 16, "kinematics").data["kinematics"]
    assert rows["hash"] == "calib_123456789"
    for link, values in UR_LINKS.items():  # every link's frame stands where meshes and the controller expect it
        row = [rows[link][key] for key in UR_KEYS]
        difference = np.linalg.solve(
            pose_matrix(*np.split(np.array(values), 2)), pose_matrix(*np.split(np.array(row), 2))
        )
        assert np.abs(difference - np.eye(4)).max() < 10 * size + 1e-12


def test_base_link_and_flange_of_ur_description(tmp_path: Path) -> None:
    """A URDF begins at base_link, half a turn from the controller's base, and may end at the link `flange`."""
    of = ur(tmp_path)
    out = tmp_path / "urdf"
    of.export(out, "--format", "urdf")
    text = (out / "robot.urdf").read_text()
    half = '<joint name="half" type="fixed"><parent link="base_link"/><child link="base_link_inertia"/>'
    half += '<origin rpy="0 0 3.141592653589793"/></joint><link name="base_link_inertia"/>'
    text = text.replace('<parent link="base_link" />', '<parent link="base_link_inertia" />')
    quarter = '<joint name="end" type="fixed"><parent link="flange"/><child link="ur_flange"/>'
    quarter += '<origin rpy="0 -1.5707963267948966 -1.5707963267948966"/></joint><link name="ur_flange"/>'
    (tmp_path / "ur.urdf").write_text(text.replace("</robot>", f"{half}{quarter}</robot>"))
    cell = read_yaml(of.cell_path, 1 << 18, "cell").data
    for key in ("dh", "joint_limits"):
        del cell["robot"][key]
    cell["robot"] |= {"urdf": "ur.urdf", "base_link": "base_link", "flange": "ur_flange"}
    path = tmp_path / "urdf.cell.yaml"
    path.write_text(yaml_text(cell))
    second = case(tmp_path, path, seed=8, effects=False)
    result = second.export(tmp_path / "out", "--format", "ur", "--template", str(template(tmp_path)))
    assert result["deviations"][0]["largest"] < 1e-6
    q, expected = model_poses(second, 100)
    base, flange = np.eye(4), np.eye(4)
    base[:3, :3] = rotation_z(math.pi)
    flange = pose_matrix(np.zeros(3), np.array([0.0, -math.pi / 2, -math.pi / 2]))
    assert np.abs(base @ rebuilt(tmp_path / "out" / "kinematics.yaml", q) @ flange - expected).max() < 1e-6


def test_without_a_template_it_says_how_to_get_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ur(tmp_path).code(tmp_path / "out", "--format", "ur") == 2
    text = capsys.readouterr().err
    assert "ros2 launch ur_calibration calibration_correction.launch.py" in text
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("rows", "changes", "place"),
    [
        (None, {"hash": None}, "kinematics.hash"),
        (None, {"forearm": {"x": 0.0}}, "kinematics.forearm"),
        (None, {"forearm": dict.fromkeys(UR_KEYS, math.nan)}, "kinematics.forearm"),
        ({**UR_LINKS, "forearm": (-0.425, 0.0, 0.0, 0.0, 0.0, 0.0)}, {}, "link frames that differ"),
    ],
)
def test_a_template_that_cannot_be_used(
    rows: dict[str, Any] | None, changes: dict[str, Any], place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = template(tmp_path, rows, **changes)
    assert ur(tmp_path).code(tmp_path / "out", "--format", "ur", "--template", str(file)) == 2
    text = capsys.readouterr().err
    assert place in text
    assert len(text.splitlines()) == 1


def test_a_robot_that_is_none_of_theirs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    of = case(tmp_path, write_cell(tmp_path, "five", UR_ROWS[:5]), effects=False)
    assert of.code(tmp_path / "out", "--format", "ur", "--template", str(template(tmp_path))) == 2
    assert "six revolute joints" in capsys.readouterr().err
