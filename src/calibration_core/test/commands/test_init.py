"""`calibration init`: a cell file that passes `check`, from a URDF, a bag or a name; nothing edited is overwritten."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from program import CELL, run

from calibration_core.cell import load_cell
from calibration_core.cell.library import library
from calibration_core.commands.files.cell_text import GUESS
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


@pytest.mark.parametrize("robot", ["ur5e", str(CELL.parent.parent / "robots" / "kr240.urdf")])
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
    robot: str, option: str, values: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    load = [] if robot == "ur5e" or option == "--rated-load" else ["--rated-load", "5"]
    assert run("init", robot, *load, option, *values, "--out", tmp_path / "my") == 2
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
