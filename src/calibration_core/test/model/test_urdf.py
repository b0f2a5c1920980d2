"""URDFs against pinocchio's own reading, and what is refused before any parser of robots sees it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.cell.urdf import MAX_BYTES, MAX_LINKS
from calibration_core.errors import CellError
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import gravity_torque
from calibration_core.model.urdf import mesh_file, urdf_bodies, urdf_shapes

CELLS = Path(__file__).resolve().parents[4] / "config" / "cells"
ROBOT = """<robot name="r"><link name="world"/><link name="base"><inertial><mass value="90"/></inertial></link>
<link name="a"><inertial><origin xyz="0.2 0.1 -0.1"/><mass value="30"/></inertial>
<visual><geometry><mesh filename="package://maker/arm.obj" scale="0.001 0.001 0.001"/></geometry></visual></link>
<link name="b"><inertial><origin xyz="0 0.3 0"/><mass value="12"/></inertial>
<collision><origin xyz="0.1 0 0"/><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision></link>
<link name="c"><inertial><mass value="5"/></inertial></link><link name="plate"/><link name="motor">
<inertial><origin xyz="0 0 0.3" rpy="1 0 0"/><mass value="7"/></inertial></link>
<joint name="foot" type="fixed"><parent link="world"/><child link="base"/><origin xyz="3 2 1" rpy="0 0 1"/></joint>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0.1 0.6" rpy="0.1 0 0.4"/>
<axis xyz="0 0 -1"/><limit lower="-3" upper="2" effort="1" velocity="1"/></joint>
<joint name="j2" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0.8 0 0" rpy="0 0.7 0"/>
<axis xyz="1 2 0.5"/></joint>
<joint name="on" type="fixed"><parent link="a"/><child link="motor"/><origin xyz="0.1 0.2 0" rpy="0.3 0 0"/></joint>
<joint name="j3" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0 0.2 0.5" rpy="0.3 0.2 0.1"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2.5" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="c"/><child link="plate"/><origin xyz="0 0 0.2" rpy="0 1 0"/></joint>
</robot>"""
CELL = """
name: test
robot: {name: r, urdf: robot.urdf, base_link: base, flange: plate, joints: [j1, j2, j3], rated_load: 20}
frames: {measurement_points: {mp1: [0.1, 0, 0]}}
instruments: {tracker: {sigma: 1.0e-5}}
"""


def cell_of(folder: Path, text: str = ROBOT, cell: str = CELL) -> Cell:
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    (folder / "arm.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "cell.yaml").write_text(cell)
    return load_cell(folder / "cell.yaml")


def compared(cell: Cell, path: str) -> None:
    """Flange and gravity torques as pinocchio has them, over random postures."""
    model = pin.buildModelFromUrdf(path)
    data, chain = model.createData(), chain_of(cell)
    pin.forwardKinematics(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    to_base = data.oMf[model.getFrameId(str(cell.robot.base_link))].inverse()
    model.gravity.linear = to_base.rotation.T @ chain.gravity  # the cell's gravity is in base axes
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (15, chain.n))
    at = posture(chain, q)
    torque = gravity_torque(chain, at)
    for k, row in enumerate(q):
        full = pin.neutral(model)
        for joint, angle in zip(cell.robot.joints, row, strict=True):
            one = model.joints[model.getJointId(joint)]
            full[one.idx_q : one.idx_q + one.nq] = [angle] if one.nq == 1 else [np.cos(angle), np.sin(angle)]
        pin.forwardKinematics(model, data, full)
        pin.updateFramePlacements(model, data)
        flange = to_base * data.oMf[model.getFrameId(str(cell.robot.flange))]
        np.testing.assert_allclose(at.flange_origin[:, k], flange.translation, atol=1e-12)
        np.testing.assert_allclose(at.flange[:, :, k].T, flange.rotation, atol=1e-12)
        expected = -pin.computeGeneralizedGravity(model, data, full)
        np.testing.assert_allclose(torque[:, k], expected[-chain.n :], rtol=1e-9, atol=1e-9)


def test_a_robot_of_odd_axes_and_links_beside_the_chain(tmp_path: Path) -> None:
    cell = cell_of(tmp_path)
    compared(cell, str(tmp_path / "robot.urdf"))
    np.testing.assert_allclose(chain_of(cell).limits, [[-3, 2], [-2 * np.pi, 2 * np.pi], [-2, 2.5]])


def test_the_demo_robot() -> None:
    cell = load_cell(CELLS / "demo.cell.yaml")
    compared(cell, str(cell.urdf_path))


def test_bodies_and_meshes_are_named_with_their_links(tmp_path: Path) -> None:
    cell = cell_of(tmp_path)
    (rod,) = urdf_bodies(cell)
    assert (rod.link, rod.name, rod.form, rod.mesh) == (2, "b", "cylinder", "")
    np.testing.assert_allclose(rod.size, [0.1, 0.4])
    (arm,) = urdf_bodies(cell, "visual")
    assert (arm.link, arm.form, arm.mesh) == (1, "mesh", "package://maker/arm.obj")
    np.testing.assert_allclose(arm.size, 1e-3)
    assert [body.name for body, _ in urdf_shapes(cell, "visual")[0]] == ["a"]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "not found"),
        ("", "empty or not readable"),
        ("solid\nendsolid\n", "empty or not readable"),
        ("v 0 0 0\n", "empty or not readable"),
    ],
)
def test_a_mesh_that_cannot_be_had_is_named_and_the_others_stay(
    tmp_path: Path, content: str | None, reason: str
) -> None:
    cell = cell_of(tmp_path, ROBOT.replace("<visual>", "<collision>").replace("</visual>", "</collision>"))
    (tmp_path / "arm.obj").unlink()
    if content is not None:
        (tmp_path / "arm.obj").write_text(content)
    shapes, lost = urdf_shapes(cell)
    assert [body.name for body, _ in shapes] == ["b"]
    assert [(body.name, why.partition(":")[0]) for body, why in lost.items()] == [("a", reason)]


@pytest.mark.parametrize(
    ("name", "lies", "variables"),
    [
        ("package://p/meshes/a.stl", "ws/src/repo/p/meshes/a.stl", {}),  # the URDF lies in ws/src/repo/p/urdf
        ("package://p/meshes/a.stl", "ws/src/p/meshes/a.stl", {}),
        ("package://p/meshes/a.stl", "ws/src/repo/meshes/a.stl", {}),  # a clone by another name
        ("../meshes/a.stl", "ws/src/repo/p/meshes/a.stl", {}),
        ("meshes/a.stl", "ws/src/repo/p/urdf/meshes/a.stl", {}),
        ("package://p/meshes/a%20b.stl", "ws/src/repo/p/meshes/a b.stl", {}),
        ("package://p/meshes/a.stl", "ros/p/meshes/a.stl", {"ROS_PACKAGE_PATH": "ros"}),
        ("package://p/meshes/a.stl", "ros/vendor/p/meshes/a.stl", {"ROS_PACKAGE_PATH": "other:ros"}),
        ("package://p/meshes/a.stl", "ros/share/p/meshes/a.stl", {"AMENT_PREFIX_PATH": "ros"}),
    ],
)
def test_meshes_are_found_beside_the_urdf_and_where_ros_looks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, lies: str, variables: dict[str, str]
) -> None:
    urdf = tmp_path / "ws" / "src" / "repo" / "p" / "urdf" / "robot.urdf"
    urdf.parent.mkdir(parents=True)
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        roots = variables.get(variable, "").split(":")
        monkeypatch.setenv(variable, ":".join(str(tmp_path / one) for one in roots if one))
    assert mesh_file(urdf, name) is None
    (tmp_path / lies).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / lies).touch()
    found = mesh_file(urdf, name)
    assert found is not None
    assert found.samefile(tmp_path / lies)


MANY = "".join(f'<link name="l{i}"/>' for i in range(5001)) + "".join(
    f'<joint name="k{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/></joint>' for i in range(5000)
)
LIMIT = '<limit lower="-3" upper="2" effort="1" velocity="1"/>'


@pytest.mark.parametrize(
    ("old", "new", "place", "found"),
    [
        (ROBOT, f'<robot name="r">{MANY}</robot>', "robot", "5001 links and 5000 joints"),
        (ROBOT, "<robot name='r'>" + " " * (MAX_BYTES + 1), "", "bytes"),
        (ROBOT, "<robot name='r'>" + "<a>" * 40, "", "levels"),
        (ROBOT, "<robot name='r'>" + "<a/>" * 60_000 + "</robot>", "", "elements"),
        ("<robot", '<!DOCTYPE r [<!ENTITY b "c">]><robot', "line 1", "DOCTYPE"),
        ("<robot", '<!doctype r SYSTEM "file:///etc/passwd"><robot', "line 1", "doctype"),
        ("<robot", '<?xml version="1.0" encoding="utf-16"?><robot', "line 1", "utf-16"),
        ("<robot", "<model", "line", "mismatched"),
        ("</robot>", "", "line", "no element found"),
        (ROBOT, "<sdf/>", "", "<sdf>"),
        (ROBOT, "", "", ""),
        ('<mass value="30"/>', '<mass value="nan"/>', "link 'a', inertial, mass", "'nan'"),
        ('<mass value="30"/>', '<mass value="inf"/>', "link 'a', inertial, mass", "'inf'"),
        ('<mass value="30"/>', '<mass value="-1"/>', "link 'a', inertial, mass", "'-1'"),
        ('<mass value="30"/>', "", "link 'a', inertial, mass", "nothing"),
        ('xyz="0 0.3 0"', 'xyz="0 1e999 0"', "link 'b', inertial, origin, xyz", "'1e999'"),
        ('xyz="0 0.3 0"', 'xyz="0 0.3"', "link 'b', inertial, origin, xyz", "'0 0.3'"),
        ('radius="0.1"', 'radius="big"', "link 'b', collision, geometry, cylinder, radius", "'big'"),
        (LIMIT, LIMIT.replace("-3", "2"), "joint 'j1', limit", "[2, 2]"),
        (LIMIT, LIMIT.replace("-3", "-185").replace('"2"', '"185"'), "joint 'j1', limit", "[-185, 185]"),
        (LIMIT, LIMIT.replace("-3", "nan"), "joint 'j1', limit, lower", "'nan'"),
        (LIMIT, LIMIT.replace("-3", "-3600").replace('"2"', '"3600"'), "joint 'j1', limit", "[-3600, 3600]"),
        (LIMIT, '<limit effort="1" velocity="1"/>', "joint 'j1', limit", "no lower and upper"),
        (LIMIT, "", "joint 'j1', limit", "no lower and upper"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "joint 'j3'", "length zero"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1"/>', "joint 'j3', axis, xyz", "'0 1'"),
        ('name="j3" type="revolute"', 'name="j3" type="hinge"', "joint 'j3'", "'hinge'"),
        ('name="j3"', 'name="j1"', "joint 'j1'", "twice"),
        ('<link name="plate"/>', '<link name="plate"/><link name="plate"/>', "link 'plate'", "twice"),
        ('<parent link="a"/><child link="b"/>', '<parent link="a"/>', "joint 'j2', child", "nothing"),
        ('<parent link="a"/><child link="b"/>', '<parent link="c"/><child link="b"/>', "link", "circle"),
        ('<parent link="b"/><child link="c"/>', '<parent link="b"/><child link="a"/>', "joint 'j3'", "second parent"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="j1"/>', "robot.joints.2", "'j3', a mimic joint"),
        ('<child link="motor"/>', '<child link="engine"/>', "joint 'on', child", "'engine'"),
    ],
)  # fmt: skip
def test_a_urdf_that_cannot_be_used_is_refused_in_one_line(
    tmp_path: Path, old: str, new: str, place: str, found: str
) -> None:
    assert old in ROBOT
    cell = cell_of(tmp_path, ROBOT.replace(old, new))
    with pytest.raises(CellError) as caught:
        chain_of(cell)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600
    assert place in str(caught.value)
    assert found in str(caught.value)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    cell = cell_of(tmp_path)
    (tmp_path / "robot.urdf").write_bytes(ROBOT.encode("utf-16"))
    with pytest.raises(CellError, match="UTF-8"):
        chain_of(cell)


@pytest.mark.parametrize("end", ["999999", "1e16", "inf"])
def test_limits_that_are_none_are_those_of_an_endless_joint(tmp_path: Path, end: str) -> None:
    open_ended = ROBOT.replace(LIMIT, LIMIT.replace("-3", f"-{end}").replace('"2"', f'"{end}"'))
    cell = cell_of(tmp_path, open_ended)
    assert chain_of(cell).limits[0].tolist() == [-2 * np.pi, 2 * np.pi]


def test_limits_of_the_cell_file_go_before_those_of_the_urdf(tmp_path: Path) -> None:
    text = CELL.replace("rated_load", "joint_limits: [[-3, 2], [-1, 1], [-2, 2]], rated_load")
    cell = cell_of(tmp_path, ROBOT.replace(LIMIT, LIMIT.replace("-3", "-185")), text)
    np.testing.assert_allclose(chain_of(cell).limits, [[-3, 2], [-1, 1], [-2, 2]])


def test_limits_of_the_cell_file_in_degrees_are_refused_beside_a_urdf(tmp_path: Path) -> None:
    text = CELL.replace("rated_load", "joint_limits: [[-185, 185], [-1, 1], [-2, 2]], rated_load")
    with pytest.raises(CellError, match=r"robot.joint_limits.0: found \[-185, 185\], expected radians.*degrees"):
        chain_of(cell_of(tmp_path, ROBOT, text))


def test_as_many_links_as_allowed_can_be_read(tmp_path: Path) -> None:
    count = MAX_LINKS - 6
    more = "".join(f'<link name="l{i}"/>' for i in range(count - 1)) + "".join(
        f'<joint name="k{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(count - 2)
    )
    bridge = '<joint name="bridge" type="fixed"><parent link="plate"/><child link="l0"/></joint>'
    cell = cell_of(tmp_path, ROBOT.replace("</robot>", f"{more}{bridge}</robot>"),
                   CELL.replace("flange: plate", f"flange: l{count - 2}"))  # fmt: skip
    assert chain_of(cell).n == 3


def test_the_reader_brings_trimesh_only_where_scenes_are_drawn() -> None:
    code = (
        "import sys\nfrom calibration_core.cell import load_cell\nfrom calibration_core.model.robot import chain_of\n"
        f"chain_of(load_cell({str(CELLS / 'demo.cell.yaml')!r}))\n"
        "import inspect; inspect.getmodule(inspect.currentframe())\n"  # as the first line of a ROS node's log does
        "assert not {'networkx', 'trimesh.base', 'pinocchio'} & set(sys.modules)\n"
        "import yourdfpy, io\n"
        "box = b'<visual><geometry><box size=\"1 2 3\"/></geometry></visual>'\n"
        "text = b'<robot name=\"r\"><link name=\"a\">' + box + b'</link></robot>'\n"
        "scene = yourdfpy.URDF.load(io.BytesIO(text)).scene\n"
        "assert sorted(scene.extents.tolist()) == [1.0, 2.0, 3.0]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_dh_rows_need_no_reader_of_urdfs() -> None:
    """The reader brings trimesh, which is slow to load."""
    code = (
        "import sys, calibration_core.cli\n"
        "from calibration_core.cell import load_cell\nfrom calibration_core.model.robot import chain_of\n"
        f"chain_of(load_cell({str(CELLS / 'small.cell.yaml')!r}))\n"
        "assert 'yourdfpy' not in sys.modules and 'trimesh' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
