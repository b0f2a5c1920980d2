"""The written URDF, read by others: their forward kinematics are the model's."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from export_cases import CELLS, case, model_poses, write_cell

from calibration_core.files.yaml_file import read_yaml
from calibration_core.model.chain import pose_matrix, rotation_rpy, rotation_x, rotation_y, rotation_z, rpy_of

NANOMETRE = 1e-9


@pytest.mark.parametrize("name", ["demo", "small"])
def test_yourdfpy_and_pinocchio_agree_with_the_model(name: str, tmp_path: Path) -> None:
    import pinocchio as pin
    import yourdfpy

    of = case(tmp_path, CELLS / f"{name}.cell.yaml")
    result = of.export(tmp_path / "out", "--format", "urdf")
    assert result["deviations"][0]["postures"] == 1000
    assert result["effects_folded"] == ["joint_zero_offset at joint_2"]
    assert result["effects_left_out"] == ["wrist_coupling at joint_6"]
    urdf = tmp_path / "out" / "robot.urdf"
    q, expected = model_poses(of)
    joints = of.cell.robot.joints
    read = yourdfpy.URDF.load(str(urdf), load_meshes=False)
    model = pin.buildModelFromUrdf(str(urdf))
    data = model.createData()
    assert list(model.names)[1:] == list(joints)
    for row, pose in zip(q, expected, strict=True):
        read.update_cfg(dict(zip(joints, row, strict=True)))
        assert np.abs(read.get_transform("flange", "base_link") - pose).max() < NANOMETRE
        pin.framesForwardKinematics(model, data, row)
        assert np.abs(data.oMf[model.getFrameId("flange")].homogeneous - pose).max() < NANOMETRE


def test_the_zero_offset_is_in_the_origin(tmp_path: Path) -> None:
    """The joint's origin is turned about its axis, y of the URDF, by the 2 mrad that the effect states."""
    turns = []
    for name, effects in (("without", False), ("with", True)):
        of = case(tmp_path, CELLS / "demo.cell.yaml", effects=effects)
        of.export(tmp_path / name, "--format", "urdf")
        root = ET.parse(tmp_path / name / "robot.urdf").getroot()
        joint = next(one for one in root.iter("joint") if one.get("name") == "joint_2")
        assert str(joint.find("axis").get("xyz")) == "0 1 0"  # type: ignore[union-attr]
        origin = joint.find("origin")
        assert origin is not None
        turns.append(rotation_rpy(*(float(x) for x in str(origin.get("rpy")).split())))
    assert rpy_of(turns[0].T @ turns[1]) == pytest.approx([0.0, 2e-3, 0.0], abs=1e-12)


def test_everything_else_of_a_urdf_stays(tmp_path: Path) -> None:
    of = case(tmp_path, CELLS / "demo.cell.yaml")
    of.export(tmp_path / "out", "--format", "urdf")
    before = ET.parse(CELLS.parent / "robots" / "kr240.urdf").getroot()
    after = ET.parse(tmp_path / "out" / "robot.urdf").getroot()
    assert [joint.get("name") for joint in after.iter("joint")] == [joint.get("name") for joint in before.iter("joint")]
    for tag in ("inertial", "limit", "axis"):
        texts = [
            ["".join(ET.tostring(one, encoding="unicode").split()) for one in root.iter(tag)]
            for root in (before, after)
        ]
        assert texts[0] == texts[1]
        assert texts[0]
    assert "joint offset" in (tmp_path / "out" / "robot.urdf").read_text()
    assert "${" not in (tmp_path / "out" / "robot.urdf").read_text()


def test_kinematics_for_a_xacro(tmp_path: Path) -> None:
    """What a xacro loads joint by joint gives the same robot."""
    of = case(tmp_path, CELLS / "small.cell.yaml")
    of.export(tmp_path / "out", "--format", "urdf")
    rows = read_yaml(tmp_path / "out" / "kinematics.yaml", 1 << 16, "kinematics").data["kinematics"]
    q, expected = model_poses(of, 50)
    chain = of.robot().chain
    flange = np.eye(4)
    flange[:3, :3], flange[:3, 3] = chain.flange_rotation, chain.flange_translation
    for angles, pose in zip(q, expected, strict=True):
        here = np.eye(4)
        for name, angle in zip(of.cell.robot.joints, angles, strict=True):
            row = rows[name]
            turn = np.eye(4)
            turn[:3, :3] = rotation_z(angle)
            here = here @ pose_matrix(
                np.array([row["x"], row["y"], row["z"]]), np.array([row["roll"], row["pitch"], row["yaw"]])
            ) @ turn  # fmt: skip
        assert np.abs(here @ flange - pose).max() < NANOMETRE


def test_meshes_are_found_from_the_new_place(tmp_path: Path) -> None:
    source = tmp_path / "robot"
    (source / "meshes").mkdir(parents=True)
    (source / "meshes" / "link.stl").write_bytes(b"solid nothing\nendsolid nothing\n")
    text = (CELLS.parent / "robots" / "kr240.urdf").read_text()
    visual = '<visual><geometry><mesh filename="meshes/link.stl"/></geometry></visual>'
    package = '<visual><geometry><mesh filename="package://some_robot/link.stl"/></geometry></visual>'
    text = text.replace('<link name="link_1">', f'<link name="link_1">{visual}{package}', 1)
    (source / "kr240.urdf").write_text(text)
    cell = (CELLS / "demo.cell.yaml").read_text().replace("../robots/kr240.urdf", "kr240.urdf")
    (source / "demo.cell.yaml").write_text(cell)
    of = case(tmp_path, source / "demo.cell.yaml")
    of.export(tmp_path / "elsewhere" / "out", "--format", "urdf")
    root = ET.parse(tmp_path / "elsewhere" / "out" / "robot.urdf").getroot()
    names = [str(mesh.get("filename")) for mesh in root.iter("mesh")]
    assert (tmp_path / "elsewhere" / "out" / names[0]).resolve() == (source / "meshes" / "link.stl").resolve()
    assert names[1] == "package://some_robot/link.stl"


def test_a_robot_on_a_rail(tmp_path: Path) -> None:
    rows = [(0.0, -math.pi / 2, 0.3), (0.2, -math.pi / 2, 0.4), (0.6, 0.0, 0.0), (0.1, -math.pi / 2, 0.0)]
    path = write_cell(tmp_path, "rail", rows, joint_types=["prismatic", "revolute", "revolute", "revolute"])
    of = case(tmp_path, path, effects=False)
    result = of.export(tmp_path / "out", "--format", "urdf")
    assert result["deviations"][0]["largest"] < NANOMETRE
    assert '<joint name="joint_1" type="prismatic">' in (tmp_path / "out" / "robot.urdf").read_text()


def test_roll_pitch_and_yaw_compose_at_a_pitch_of_90_degrees() -> None:
    """There roll and yaw are one turn; rounding errors must not tear them apart."""
    rng = np.random.default_rng(5)
    for pitch in (math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-9, math.pi / 2 - 1e-6):
        for _ in range(50):
            roll, yaw, twist = rng.uniform(-3, 3, 3)
            rotation = rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll - twist) @ rotation_x(twist)
            assert np.abs(rotation_rpy(*rpy_of(rotation)) - rotation).max() < 1e-14
