"""`calibration init`: a cell file that passes `check`, from a URDF, a bag or a name; nothing edited is overwritten."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from newcomer import robot
from program import CELL, run

from calibration_core.cell import load_cell
from calibration_core.cell.library import library
from calibration_core.commands.files.cell_text import GUESS
from calibration_core.model.urdf import urdf_shapes
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.bags.writer import write_bag

DEMO = CELL.with_name("demo.cell.yaml")


@pytest.mark.parametrize("key", library())
def test_every_robot_of_the_library_gives_a_cell_that_passes_check(key: str, tmp_path: Path) -> None:
    assert run("init", key, "--out", tmp_path / "my") == 0
    assert {path.name for path in (tmp_path / "my").iterdir()} == {
        "cell.yaml", "cell.schema.json", "robot.urdf", "result.json",
    }  # fmt: skip
    assert run("check", tmp_path / "my" / "cell.yaml", "--out", tmp_path / "check", "--no-report") == 0
    text = (tmp_path / "my" / "cell.yaml").read_text()
    assert text.startswith("# yaml-language-server: $schema=cell.schema.json\n")
    assert text.count(GUESS) == 6  # the legend, and the five lines that hold usual values


def test_what_is_stated_stands_in_the_file(tmp_path: Path) -> None:
    options = [
        "--rated-load",
        210,
        "--name",
        "a: b # c",
        "--sensor",
        0,
        0,
        0.06,
        0,
        0,
        0.3,
        "--wrench-point",
        0.1,
        0,
        0.2,
    ]
    options += ["--point", "mp1=0.17,0,-0.12", "--point", "no=1e-3,0.1,0", "--tracker", 4, 1, 1.2, 0, 0, -2.9]
    options += ["--tracker-sigma", 1e-5, "--force-sigma", 2, "--torque-sigma", 0.7]
    assert run("init", DEMO.parent / "../robots/kr240.urdf", *options, "--out", tmp_path / "my") == 0
    cell = load_cell(tmp_path / "my" / "cell.yaml")
    assert (cell.name, cell.robot.rated_load, cell.robot.flange) == ("a: b # c", 210.0, "flange")
    assert dict(cell.frames.measurement_points) == {"mp1": (0.17, 0.0, -0.12), "no": (0.001, 0.1, 0.0)}
    assert cell.frames.tracker is not None
    assert (cell.frames.tracker.xyz, cell.frames.tracker.rpy) == ((4.0, 1.0, 1.2), (0.0, 0.0, -2.9))
    assert cell.frames.force_torque is not None
    assert cell.frames.force_torque.rpy == (0.0, 0.0, 0.3)
    assert cell.instruments.tracker.sigma == 1e-5
    result = json.loads((tmp_path / "my" / "result.json").read_text())
    assert (result["command"], result["guessed"]) == ("init", [])
    text = (tmp_path / "my" / "cell.yaml").read_text()
    assert text.count(GUESS) == 1  # the legend


def test_the_robot_description_of_a_bag_is_enough(tmp_path: Path, simulated: Path) -> None:
    recording = read_bag(simulated / "recording", load_cell(CELL))
    urdf = (CELL.parent.parent / "robots" / "kr240.urdf").read_text()
    import dataclasses

    write_bag(tmp_path / "bag", dataclasses.replace(recording, robot_description=urdf), load_cell(CELL))
    assert run("init", tmp_path / "bag", "--rated-load", 240, "--out", tmp_path / "my") == 0
    assert load_cell(tmp_path / "my" / "cell.yaml").robot.joints == tuple(f"joint_{i}" for i in range(1, 7))


def test_what_is_missing_is_said_in_one_line(
    tmp_path: Path, simulated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = CELL.parent.parent / "robots" / "kr240.urdf"
    (tmp_path / "robot.xacro").write_text("<robot/>")
    cases = {
        (urdf,): "--rated-load KG",
        (urdf, "--rated-load", 240, "--flange", "nowhere"): "a link of the URDF",
        (tmp_path / "gone.urdf", "--rated-load", 1): "No such file",
        (simulated / "recording", "--rated-load", 1): "no message on /robot_description",
        ("ur11e",): "did you mean",
        (tmp_path / "robot.xacro", "--rated-load", 1): "xacro robot.xacro > robot.urdf",
    }
    for words, expected in cases.items():
        assert run("init", *words, "--out", tmp_path / "my") == 2
        error = capsys.readouterr().err
        assert expected in error
        assert len(error.splitlines()) == 1
        assert not (tmp_path / "my").exists()


@pytest.mark.parametrize(
    ("option", "values"),
    [
        *(("--rated-load", [value]) for value in ("-5", "0", "nan", "inf", "1e12")),
        *(("--tracker-sigma", [value]) for value in ("-1", "0", "nan", "1e9")),
        *((option, [value]) for option in ("--force-sigma", "--torque-sigma") for value in ("-1", "nan", "1e9")),
        *((option, ["0", "nan", "0", "0", "0", "0"]) for option in ("--tracker", "--sensor")),
        ("--wrench-point", ["0", "0", "inf"]),
        ("--point", ["mp1=nan,0,0"]),
        ("--point", ["mp1=0,0,0", "--point", "mp1=1,0,0"]),
        ("--name", [""]),
    ],
)
def test_a_wrong_option_is_named(
    option: str, values: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("init", "ur5e", option, *values, "--out", tmp_path / "my") == 2
    error = capsys.readouterr().err
    assert error.startswith(f"{option}: found ")
    assert error.count("\n") == 1
    assert not (tmp_path / "my").exists()


@pytest.mark.parametrize("robot", ["ur5e", str(CELL.parent.parent / "robots" / "kr240.urdf")])
def test_a_wrong_link_is_named_with_the_robot(robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option, place in (("--base-link", "base link"), ("--flange", "flange")):
        assert run("init", robot, "--rated-load", 5, option, "foo", "--out", tmp_path / "my") == 2
        assert capsys.readouterr().err.startswith(f"{robot}: {place}: found 'foo', expected a link of the URDF: ")


def test_a_noiseless_sensor_that_is_stated_is_not_taken_for_unknown(tmp_path: Path) -> None:
    assert run("init", "ur5e", "--force-sigma", 0, "--torque-sigma", 0, "--out", tmp_path / "my") == 0
    sensor = load_cell(tmp_path / "my" / "cell.yaml").instruments.force_torque
    assert sensor is not None
    assert (sensor.sigma_force, sensor.sigma_torque) == (0.0, 0.0)


def test_an_edited_file_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("init", "ur5e", "--out", tmp_path / "my") == 0
    (tmp_path / "my" / "cell.yaml").write_text("mine")
    assert run("init", "ur5e", "--out", tmp_path / "my") == 2
    assert "what was edited is not overwritten" in capsys.readouterr().err
    assert (tmp_path / "my" / "cell.yaml").read_text() == "mine"


def test_somebody_at_a_terminal_is_asked(tmp_path: Path) -> None:
    """A real terminal: answers are typed, a wrong one is asked for again, an empty one leaves the usual value."""
    parent, child = pty.openpty()
    words = [sys.executable, "-m", "calibration_core.cli", "init", "ur5e", "--out", str(tmp_path / "my")]
    process = subprocess.Popen(words, stdin=child, stdout=child, stderr=child, close_fds=True)
    os.close(child)
    os.write(parent, b"3 0 1\n0 0\n0 0 0.04\n\np=0.1,0,0 r=0,0.1,0\n")
    seen = b""
    while True:
        try:
            piece = os.read(parent, 4096)
        except OSError:
            break
        if not piece:
            break
        seen += piece
    assert process.wait(30) == 0, seen
    assert b"2 numbers instead of 3 or 6" in seen
    cell = load_cell(tmp_path / "my" / "cell.yaml")
    assert cell.frames.tracker is not None
    assert cell.frames.tracker.xyz == (3.0, 0.0, 1.0)
    assert cell.points == ("p", "r")
    assert "frames.wrench_point" in json.loads((tmp_path / "my" / "result.json").read_text())["guessed"]


TRIANGLE = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.1 0 0\nvertex 0 0.1 0\nendloop\nendfacet\n"
COLLISION = '<collision><geometry><mesh filename="package://rb25/meshes/l1.stl"/></geometry></collision>'


def described(path: Path, *, more: str = "", mesh: bool = False, prefix: str = "") -> Path:
    """Write the URDF of an arm, with further elements, a mesh, and a prefix before its own links' and joints' names."""
    text = robot().replace('<link name="l1">', f'<link name="l1">{COLLISION if mesh else ""}')
    if prefix:
        for name in ("base_link", "tool0", "end", *(f"l{i}" for i in range(1, 7)), *(f"axis_{i}" for i in range(1, 7))):
            text = text.replace(f'"{name}"', f'"{prefix}{name}"')
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text.replace("</robot>", f"{more}</robot>"))
    return path


def test_an_end_effector_is_a_flange_where_no_other_is_named(tmp_path: Path) -> None:
    urdf = described(tmp_path / "arm.urdf")
    urdf.write_text(urdf.read_text().replace('"tool0"', '"arm_end_effector"'))
    assert run("init", urdf, "--rated-load", 25, "--out", tmp_path / "my") == 0
    assert load_cell(tmp_path / "my" / "cell.yaml").robot.flange == "arm_end_effector"


def remarks_of(folder: Path) -> list[str]:
    remarks: list[str] = json.loads((folder / "result.json").read_text())["remarks"]
    return remarks


@pytest.mark.parametrize("given", ["beside", "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "--meshes"])
def test_meshes_go_with_the_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str) -> None:
    """Wherever they lay: the folder of the cell can be moved or sent to somebody else."""
    roots = {"beside": "ws", "AMENT_PREFIX_PATH": "else/share"}
    place = tmp_path / roots.get(given, "else") / "rb25" / "meshes" / "l1.stl"
    place.parent.mkdir(parents=True)
    place.write_text(TRIANGLE + "endsolid a\n")
    for i in range(2, 7):
        place.with_name(f"l{i}.stl").write_text(TRIANGLE + "endsolid a\n")
    urdf = described(tmp_path / "ws" / "rb25" / "urdf" / "rb25.urdf", mesh=True)
    if given.isupper():
        monkeypatch.setenv(given, str(tmp_path / "else"))
    options = ["--meshes", tmp_path / "else"] if given == "--meshes" else []
    assert run("init", urdf, "--rated-load", 25, *options, "--out", tmp_path / "my") == 0
    assert remarks_of(tmp_path / "my") == []
    monkeypatch.delenv(given, raising=False)
    (tmp_path / "my").rename(tmp_path / "moved")
    place.unlink()
    shapes, lost = urdf_shapes(load_cell(tmp_path / "moved" / "cell.yaml"))
    assert [body.name for body, _ in shapes] == ["l1"]
    assert lost == {}


def test_missing_meshes_are_a_remark_and_capsules_take_their_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = described(tmp_path / "rb25.urdf", mesh=True)
    assert run("init", urdf, "--rated-load", 25, "--tracker", 3, 0, 1, 0, 0, 3, "--out", tmp_path / "my") == 0
    (remark,) = remarks_of(tmp_path / "my")
    assert remark.startswith("Meshes: 6 of 6 not found (package://rb25/meshes/l1.stl, ")
    assert remark in capsys.readouterr().out
    cell = tmp_path / "my" / "cell.yaml"
    assert run("check", cell, "--out", tmp_path / "check", "--no-report") == 0
    assert "package://rb25/meshes/l1.stl (not found)" in capsys.readouterr().out
    options = ("--configurations", 12, "--spares", 0, "--out", tmp_path / "plan", "--no-report")
    assert run("plan", "--cell", cell, *options) == 0
    assert "capsules along the links take their place" in capsys.readouterr().out


FIXED = '<joint name="{0}" type="fixed"><parent link="{1}"/><child link="{2}"/><origin rpy="{3}"/></joint>'
OTHER_FLANGE = '<link name="flange"/>' + FIXED.format("f", "l6", "flange", "0 0 0")  # its z lies across axis 6
GRIPPER = """<link name="finger"/><joint name="finger_joint" type="revolute"><parent link="tool0"/>
<child link="finger"/><axis xyz="0 1 0"/><limit lower="0" upper="0" effort="0" velocity="0"/></joint>"""
COLUMN = """<link name="world"/><link name="foot"/><link name="mast"/>
<joint name="lift_1" type="prismatic"><parent link="foot"/><child link="mast"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
<joint name="lift_2" type="prismatic"><parent link="foot"/><child link="base_link"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.5" effort="1" velocity="1"/><mimic joint="lift_1" multiplier="2"/></joint>"""

CART = """<link name="cart"/><joint name="steer" type="revolute"><parent link="world"/><child link="cart"/>
<axis xyz="0 0 1"/><limit lower="-999999" upper="999999"/></joint>
<joint name="drive" {}<parent link="cart"/><child link="m_base_link"/></joint>"""


@pytest.mark.parametrize(
    ("more", "prefix", "options", "flange", "remark"),
    [
        ("", "", [], "tool0", None),
        (OTHER_FLANGE, "", [], "tool0", None),  # of REP 199: x outwards
        (OTHER_FLANGE, "", ["--flange", "flange"], "flange", "The z axis of flange does not lie along the last joint"),
        ("", "cell/arm/", [], "cell/arm/tool0", None),
        (GRIPPER, "", [], "tool0", None),
        (COLUMN, "", ["--base-link", "foot"], "tool0", "Joint lift_2 mimics a joint beside the arm"),
        (FIXED.format("stand", "world", "base_link", "0 0 0"), "", [], "tool0", None),  # a world without a link
        *(
            (CART.format(joint), "m_", [], "m_tool0", "The arm begins at m_base_link: joint drive")
            for joint in (
                'type="prismatic"><axis xyz="1 0 0"/><limit lower="-999999" upper="999999"/>',
                'type="prismatic"><axis xyz="1 0 0"/>',
                'type="planar">',
                'type="floating">',
            )
        ),
    ],
    ids=["plain", "two flanges", "stated", "prefix", "gripper", "column", "world", "cart", "open", "planar", "float"],
)
def test_the_arm_is_found_whatever_else_the_urdf_holds(
    tmp_path: Path, more: str, prefix: str, options: list[str], flange: str, remark: str | None
) -> None:
    urdf = described(tmp_path / "rb25.urdf", more=more, prefix=prefix)
    urdf.write_text(urdf.read_text().replace("<visual><geometry><mesh", "<!--").replace("</geometry></visual>", "-->"))
    assert run("init", urdf, "--rated-load", 25, *options, "--out", tmp_path / "my") == 0
    cell = load_cell(tmp_path / "my" / "cell.yaml")
    assert (cell.robot.flange, cell.robot.joints) == (flange, tuple(f"{prefix}axis_{i}" for i in range(1, 7)))
    found = [one for one in remarks_of(tmp_path / "my") if not one.startswith("Meshes")]
    assert found == [] if remark is None else found[0].startswith(remark)
    assert run("check", tmp_path / "my" / "cell.yaml", "--out", tmp_path / "check", "--no-report") == 0


def test_a_robot_without_a_name_is_called_as_its_file(tmp_path: Path) -> None:
    urdf = described(tmp_path / "ur3.urdf")
    urdf.write_text(urdf.read_text().replace('<robot name="rb25">', "<robot>"))
    assert run("init", urdf, "--rated-load", 3, "--out", tmp_path / "my") == 0
    assert load_cell(tmp_path / "my" / "cell.yaml").robot.name == "ur3"
    assert run("check", tmp_path / "my" / "cell.yaml", "--out", tmp_path / "check", "--no-report") == 0


@pytest.mark.parametrize("fingers", [(), ("thumb", "finger")])
def test_a_further_arm_is_mentioned_without_its_gripper(tmp_path: Path, fingers: tuple[str, ...]) -> None:
    left, right = (described(tmp_path / f"{side}.urdf", prefix=f"{side}_").read_text() for side in ("left", "right"))
    stand = "".join(FIXED.format(f"{side}_stand", "torso", f"{side}_base_link", "0 0 0") for side in ("left", "right"))
    stand += "".join(GRIPPER.replace("finger", f"right_{name}").replace('"tool0"', '"right_tool0"') for name in fingers)
    both = left.replace("</robot>", "") + right[right.index("<link") :].replace(
        "</robot>", f'<link name="torso"/>{stand}</robot>'
    )
    (tmp_path / "both.urdf").write_text(both)
    assert run("init", tmp_path / "both.urdf", "--rated-load", 25, "--out", tmp_path / "my") == 0
    further = "A further arm with 6 joints ends at right_tool0: --flange right_tool0 takes it."
    assert further in remarks_of(tmp_path / "my")


def test_a_xacro_text_by_another_name_is_said_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = robot().replace('<robot name="rb25">', '<robot name="rb25" xmlns:xacro="http://ros.org/wiki/xacro">')
    (tmp_path / "robot.urdf").write_text(text.replace("</robot>", '<xacro:arm prefix=""/></robot>'))
    assert run("init", tmp_path / "robot.urdf", "--rated-load", 25, "--out", tmp_path / "my") == 2
    error = capsys.readouterr().err
    assert "an element of xacro" in error
    assert error.count("\n") == 1
    (tmp_path / "robot.urdf").write_text(text.replace("</robot>", "<!-- <xacro:arm/> -->\n</robot>"))  # what it leaves
    assert run("init", tmp_path / "robot.urdf", "--rated-load", 25, "--out", tmp_path / "my") == 0
