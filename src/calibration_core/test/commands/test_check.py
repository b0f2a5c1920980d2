"""`calibration check`: every error at once with its line, what is hard to believe, words, drawing, and a recording."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from program import CELL, names, run
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from calibration_core.cell import load_cell
from calibration_core.outcomes.cell_check import match_bag
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.bags.writer import write_bag

DEMO = CELL.with_name("demo.cell.yaml")
GOOD = DEMO.read_text().replace("../robots/", f"{DEMO.parent.parent / 'robots'}/")


def checked(tmp_path: Path, text: str, *more: object) -> int:
    (tmp_path / "my.cell.yaml").write_text(text)
    return run("check", tmp_path / "my.cell.yaml", *more, "--out", tmp_path / "out")


def test_a_good_file_is_explained_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert checked(tmp_path, GOOD) == 0
    said = capsys.readouterr().out
    assert "KR 240 class: six turning joints (URDF)" in said
    assert "Tracker: 4.29 m from the base, at x 4 m, y 1 m, z 1.2 m" in said
    assert "Unusual" not in said
    assert names(tmp_path / "out") == {"result.json", "report.html", "report.pdf", "cell.html", "cell.png"}
    picture = imread(io.BytesIO((tmp_path / "out" / "cell.png").read_bytes()))
    assert 0.02 < np.mean(picture < 0.98) < 0.5
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert (result["command"], result["unusual"]) == ("check", [])
    assert "scene-data" in (tmp_path / "out" / "report.html").read_text()


def test_every_error_is_a_line_with_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = GOOD.replace("rated_load: 240.0", "rated_load: heavy").replace("sigma: 2.0e-5", "sigma: .nan")
    text = text.replace("wrench_point:", "wrenchpoint:").replace("kr240.urdf", "gone.urdf")
    assert checked(tmp_path, text) == 2
    streams = capsys.readouterr()
    lines = streams.out.splitlines()
    assert len(lines) == 4
    for line, place in zip(
        lines, ("robot.rated_load", "frames.wrenchpoint", "instruments.tracker.sigma"), strict=False
    ):
        number = int(line.split("my.cell.yaml:")[1].split(":")[0])
        assert place.rpartition(".")[2] in text.splitlines()[number - 1]
        assert place in line
    assert "gone.urdf" in lines[3]
    assert all(": found " in line and ", expected " in line for line in lines)
    assert streams.err.count("\n") == 1
    assert "found 4 errors, expected none" in streams.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "place", "cause"),
    [
        ("xyz: [4.0, 1.0, 1.2]", "xyz: [4000.0, 1000.0, 1200.0]", "frames.tracker.xyz", "millimetres"),
        ("rpy: [0.0, 0.0, -2.9]", "rpy: [0.0, 0.0, -166.0]", "frames.tracker.rpy.2", "degrees"),
        ("mp2: [-0.09, 0.15, 0.12]", "mp2: [-90.0, 150.0, 120.0]", "frames.measurement_points.mp2", "millimetres"),
        ("wrench_point: [0.12, -0.08, 0.25]", "wrench_point: [120, -80, 250]", "frames.wrench_point", "millimetres"),
        ("tracker: {sigma: 2.0e-5", "tracker: {sigma: 0.03", "instruments.tracker.sigma", "millimetres"),
        ("sigma_force: 1.0", "sigma_force: 2000", "instruments.force_torque.sigma_force", "rated load"),
    ],
)
def test_what_cannot_be_is_an_error_with_its_likely_cause(
    old: str, new: str, place: str, cause: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in GOOD
    assert checked(tmp_path, GOOD.replace(old, new)) == 2
    (line,) = capsys.readouterr().out.splitlines()
    assert f": {place}: found " in line
    assert cause in line
    number = int(line.split("my.cell.yaml:")[1].split(":")[0])
    assert new.split(":", maxsplit=1)[0] in GOOD.replace(old, new).splitlines()[number - 1]


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("rpy: [0.0, 0.0, -2.9]", "rpy: [0.0, 0.0, -166.0]", "frames.tracker.rpy.2"),
        ("rpy: [0.0, 0.0, 0.3]", "rpy: [0.0, 90.0, 0.3]", "frames.force_torque.rpy.1"),
        ("rated_load: 240.0", "rated_load: 240.0\n  gravity: [0.0, 0.0, -9806.65]", "robot.gravity"),
        ("mp2: [-0.09", '"mp2\\n": [-0.09', "frames.measurement_points.mp2"),
    ],
)
def test_what_no_recording_can_have_every_command_refuses_alike(
    old: str, new: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in GOOD
    assert checked(tmp_path, GOOD.replace(old, new)) == 2
    (line,) = capsys.readouterr().out.splitlines()
    assert f": {place}" in line
    for command in (("plan",), ("identify", "gone.csv"), ("deflect", "--model", "gone.yaml", "--q", "0")):
        assert run(*command, "--cell", tmp_path / "my.cell.yaml", "--out", tmp_path / "out") == 2
        assert line in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("xyz: [4.0, 1.0, 1.2]", "xyz: [60.0, 1.0, 1.2]", "frames.tracker.xyz"),
        ("xyz: [4.0, 1.0, 1.2]", "xyz: [0.3, 0.1, 0.2]", "frames.tracker.xyz"),
        ("stiffness: [2.2e+6", "stiffness: [2.2e+2", "robot.stiffness.0"),
        ("tracker: {sigma: 2.0e-5", "tracker: {sigma: 2.0e-8", "instruments.tracker.sigma"),
        ("mp3: [-0.09, -0.15, 0.18]", "mp3: [0.17, 0.0005, 0.12]", "frames.measurement_points"),
        ("rated_load: 240.0", "rated_load: 24000.0", "robot"),
    ],
)
def test_what_is_unusual_is_said_and_no_error(
    old: str, new: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in GOOD
    assert checked(tmp_path, GOOD.replace(old, new), "--no-report") == 0
    assert f"Unusual: {place}: found " in capsys.readouterr().out


def test_a_recording_that_fits_is_described(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind, words in {"recording": "messages over", "measurements.csv": "targets, with wrench"}.items():
        assert run("check", CELL, simulated / kind, "--out", tmp_path / kind) == 0
        said = capsys.readouterr().out
        assert words in said
        assert "Recording: " in said
    result = json.loads((tmp_path / "recording" / "result.json").read_text())
    states = {one["role"]: one["state"] for one in result["topics"]}
    assert states["joint states"] == states["target mp1"] == states["wrench"] == "read"


def test_topics_and_joints_that_do_not_match_are_named(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = CELL.read_text().replace("joint_3, joint_4", "elbow, joint_4").replace("mp2:", "target_b:")
    (tmp_path / "other.yaml").write_text(text)
    assert run("check", tmp_path / "other.yaml", simulated / "recording", "--out", tmp_path / "out") == 2
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert "names joint_1, joint_2, joint_3" in lines[0]
    assert (
        "target target_b (/tracker/target_b): found not in the recording; of that type there: /tracker/mp2" in lines[1]
    )


def test_another_topic_of_the_type_of_an_optional_one_makes_it_no_fault(tmp_path: Path) -> None:
    cell = load_cell(CELL)
    motors = cell.model_copy(update={"topics": cell.topics.model_copy(update={"temperature": "/motor_temperature"})})
    write_bag(tmp_path / "bag", read_bag(CELL.parents[2] / "bags" / "small_loaded", cell), motors)
    (found,) = [one for one in match_bag(tmp_path / "bag", cell) if one.role == "temperature"]
    assert found.state == "optional"
    assert "of that type there: /motor_temperature" in found.text


def test_topics_without_a_message_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        text = writer.add_connection("/rosout", "std_msgs/msg/String", typestore=store)
        writer.write(text, 1, store.serialize_cdr(store.types["std_msgs/msg/String"]("begun"), "std_msgs/msg/String"))
    assert run("check", CELL, tmp_path / "bag", "--out", tmp_path / "out") == 2
    assert "joint states (/joint_states): found holds no message" in capsys.readouterr().out


def test_what_init_guessed_is_named_until_it_is_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home = tmp_path / "my cell"
    assert run("init", "ur10e", "--out", home) == 0
    cell = home / "cell.yaml"
    assert f"next: calibration check '{cell}'" in capsys.readouterr().out
    assert run("check", cell, "--out", tmp_path / "out", "--no-report") == 0
    said = capsys.readouterr().out.splitlines()
    marked = [line for line in said if "TO BE MEASURED" in line]
    assert len(marked) == 1
    numbers = [int(word) for word in marked[0].removeprefix("Unusual: lines ").partition(":")[0].split(", ")]
    lines = cell.read_text().splitlines()
    assert numbers == [i for i, line in enumerate(lines, 1) if line.endswith("TO BE MEASURED") and i > 3]
    assert said[-1] == f"next: calibration identify RECORDING --cell '{cell}'"
    cell.write_text("\n".join(line.removesuffix("TO BE MEASURED") for line in lines))
    assert run("check", cell, "--out", tmp_path / "out", "--no-report") == 0
    assert "TO BE MEASURED" not in capsys.readouterr().out


def test_what_to_type_next_is_said(simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = simulated / "measurements.csv"
    assert run("check", CELL, table, "--out", tmp_path / "out", "--no-report") == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"next: calibration identify {table} --cell {CELL}"
    assert run("check", CELL, "--out", tmp_path / "out", "--no-report") == 0
    assert f"next: calibration plan --cell {CELL}; once it is measured: " in capsys.readouterr().out
    assert run("import", table, "--out", tmp_path / "in one") == 0
    said = capsys.readouterr().out.splitlines()[-1]
    assert said == f"next: calibration identify '{tmp_path / 'in one' / 'measurements.csv'}' --cell CELL.yaml"


URDF = (
    '<robot name="r"><link name="l0"/>{links}<link name="end"/>{joints}<joint name="on" type="fixed">'
    '<parent link="l4"/><child link="end"/><origin xyz="0 0 0.2" rpy="{end}"/></joint></robot>'
)
TURNS = 'lower="-2" upper="2"'


def described(
    folder: Path, *, travel: str = 'lower="-1" upper="1"', mass: float = 20.0, rpy: str = "0 0 0", inner: str = "0 0 0",
    end: str = "0 0 0", rated: float = 14.0, slides: int = 0,
) -> Path:  # fmt: skip
    """Write a cell of a robot with one sliding joint, the first or a later one."""
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0.1 0 0" rpy="{inner}"/><mass value="{mass if i == 2 else 20}"/>'
        "</inertial></link>"
        for i in range(1, 5)
    )
    joints = "".join(
        f'<joint name="j{i}" type="{"prismatic" if i == slides else "revolute"}"><parent link="l{i}"/>'
        f'<child link="l{i + 1}"/><origin xyz="0.3 0 0.3" rpy="{rpy if i == 1 else "0 0 0"}"/>'
        f'<axis xyz="0 {i % 2} {(i + 1) % 2}"/><limit {travel if i == slides else TURNS}/></joint>'
        for i in range(4)
    )
    (folder / "robot.urdf").write_text(URDF.format(links=links, joints=joints, end=end))
    path = folder / "sliding.cell.yaml"
    path.write_text(
        "name: sliding\nrobot:\n  name: r\n  urdf: robot.urdf\n  base_link: l0\n  flange: end\n"
        f"  joints: [j0, j1, j2, j3]\n  rated_load: {rated}\nframes:\n  measurement_points:\n"
        "    mp1: [0.1, 0, 0.05]\n    mp2: [-0.05, 0.09, 0.05]\n    mp3: [-0.05, -0.09, 0.08]\n"
        "instruments:\n  tracker: {sigma: 2.0e-5}\n"
    )
    return path


@pytest.mark.parametrize("where", ["rpy", "inner", "end"])
def test_angles_of_a_urdf_in_degrees_are_refused(
    where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = described(tmp_path, **{where: "90 0 0"})  # type: ignore[arg-type]
    words = "rpy: found '90 0 0', expected radians, at most one turn (6.28) either way: is it in degrees?"
    for command in (("check", cell), ("plan", "--cell", cell), ("init", tmp_path / "robot.urdf")):
        assert run(*command, "--out", tmp_path / "out") == 2
        streams = capsys.readouterr()
        assert words in streams.out + streams.err
    assert run("check", described(tmp_path, **{where: "6.2831853 -3.1416 0"}), "--out", tmp_path / "out") == 0  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"travel": 'lower="-1000" upper="1000"'}, 2, "a travel of j0 up to 1,000 m, expected a travel in metres"),
        ({"travel": 'lower="0" upper="300"'}, 0, "a travel of j0 up to 300 m, expected a travel in metres"),
        ({"travel": 'lower="0" upper="400"', "slides": 2}, 2, "a travel of j2 up to 400 m, expected a travel in"),
        ({"travel": 'lower="0" upper="50"', "slides": 2}, 0, "a travel of j2 up to 50 m, expected a travel in"),
        ({"mass": 8000}, 0, "a link of 8,000 kg behind j1, for a rated load of 14 kg, expected kilograms, at most"),
        ({"mass": 2500, "rated": 1000.0}, 0, "a link of 2,500 kg behind j1"),
        ({"mass": 700, "rated": 3.0}, 0, "a link of 700 kg behind j1, for a rated load of 3 kg"),
        ({"travel": 'lower="0" upper="90"'}, 0, ""),
        ({"travel": 'lower="0" upper="2.5"', "slides": 2}, 0, ""),
        ({"mass": 1500, "rated": 1000.0}, 0, ""),
        ({"mass": 300, "rated": 10.0}, 0, ""),
    ],
)
def test_travels_in_millimetres_and_masses_in_grams_are_named(
    changes: dict[str, Any], code: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = described(tmp_path, **changes)
    assert run("check", cell, "--no-report", "--out", tmp_path / "out") == code
    printed = capsys.readouterr().out
    if words:
        assert f"robot.urdf: found {words}" in printed
    else:
        assert "a travel of" not in printed
        assert "grams" not in printed


def test_a_travel_in_millimetres_is_planned_with_by_no_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = described(tmp_path, travel='lower="-1000" upper="1000"')
    assert run("plan", "--cell", cell, "--out", tmp_path / "out") == 2
    assert "the URDF's limits of sliding joints: 1,000 m, at most 500 m is plausible" in capsys.readouterr().err
