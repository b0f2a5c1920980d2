"""`calibration check`: every error at once with its line, what is hard to believe, words, drawing, and a recording."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from program import CELL, names, run
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

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


def test_topics_without_a_message_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        text = writer.add_connection("/rosout", "std_msgs/msg/String", typestore=store)
        writer.write(text, 1, store.serialize_cdr(store.types["std_msgs/msg/String"]("begun"), "std_msgs/msg/String"))
    assert run("check", CELL, tmp_path / "bag", "--out", tmp_path / "out") == 2
    assert "joint states (/joint_states): found holds no message" in capsys.readouterr().out


def test_a_table_of_another_robot_is_named(simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (simulated / "measurements.csv").read_text().splitlines()
    at = lines[0].split(",").index("x")
    moved = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[at : at + 3] = [str(1e3 * float(value)) for value in cells[at : at + 3]]
        moved.append(",".join(cells))
    (tmp_path / "mm.csv").write_text("\n".join(moved) + "\n")
    assert run("check", CELL, tmp_path / "mm.csv", "--out", tmp_path / "out") == 2
    assert "mm.csv" in capsys.readouterr().out


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
