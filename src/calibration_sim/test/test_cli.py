"""The program: what it writes, and what it refuses."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import Reader

from calibration_core.cell import Cell
from calibration_core.errors import EquilibriumError
from calibration_core.files.yaml_file import yaml_text
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.tables.table import read_table
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.streams import simulate_recording
from calibration_sim.cell.table import simulate_readings
from calibration_sim.cell.truth import draw_truth
from calibration_sim.cli import main

TOPICS = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tracker/mp1": "geometry_msgs/msg/PointStamped",
    "/tracker/mp2": "geometry_msgs/msg/PointStamped",
    "/tracker/mp3": "geometry_msgs/msg/PointStamped",
    "/force_torque/wrench": "geometry_msgs/msg/WrenchStamped",
    "/cell/temperature": "sensor_msgs/msg/Temperature",
    "/robot_description": "std_msgs/msg/String",
    "/calibration/step": "calibration_interfaces/msg/MeasurementStep",
}


def _topics(path: Path) -> dict[str, str]:
    with Reader(path) as reader:
        assert reader.message_count > 1000
        return {connection.topic: str(connection.msgtype) for connection in reader.connections}


def test_record_writes_bag_table_and_truth(demo: Cell, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, table, truth = tmp_path / "bag", tmp_path / "table.csv", tmp_path / "truth.yaml"
    arguments = ["record", "--cell", str(demo.path), "--out", str(bag), "--seed", "4", "--configurations", "2"]
    assert main([*arguments, "--table", str(table), "--truth-out", str(truth)]) == 0
    assert "2 configurations, 18 steps" in capsys.readouterr().out
    assert _topics(bag) == TOPICS
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 9 * 3
    assert {row["point"] for row in rows} == set(demo.points)
    stiffness = yaml.safe_load(truth.read_text())["stiffness"]
    assert list(stiffness.values()) == draw_truth(demo, 4).stiffness.tolist()


def test_what_is_recorded_reads_back_to_the_bit(demo: Cell, tmp_path: Path) -> None:
    bag, table = tmp_path / "bag", tmp_path / "table.csv"
    arguments = ["--out", str(bag), "--table", str(table), "--seed", "1", "--configurations", "2"]
    assert main(["record", "--cell", str(demo.path), *arguments]) == 0
    truth, protocol = draw_truth(demo, 1), random_protocol(demo, 2, 1)
    sent, got = simulate_recording(demo, truth, protocol, 1), read_bag(bag, demo)
    assert got.wrench is not None
    assert sent.wrench is not None
    pairs = [(sent.joints, got.joints), (sent.wrench, got.wrench)]
    for a, b in [*pairs, *((sent.points[name], got.points[name]) for name in demo.points)]:
        assert np.array_equal(a.time, b.time)
        assert np.array_equal(a.received, b.received)
        assert np.array_equal(a.values, b.values)
        assert a.frame == b.frame
    readings, rows = simulate_readings(demo, truth, protocol, 1), read_table(table, demo)
    assert np.array_equal(rows.position, readings.position)
    assert np.array_equal(rows.step, readings.step)


@pytest.mark.parametrize(("storage", "compression"), [("mcap", "lz4"), ("sqlite3", "zstd")])
def test_record_follows_a_plan(
    demo: Cell, tmp_path: Path, storage: str, compression: str, capsys: pytest.CaptureFixture[str]
) -> None:
    steps = [[0.0] * 6, [0.0, 300.0, -900.0, 0.0, 0.0, 0.0]]
    rows = [{"number": n, "q": [0.1 * n, 0.2, -0.3, 0.4, 0.5, 0.6], "steps": steps} for n in (3, 8)]
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml_text({"configurations": rows}))
    options = ["--storage", storage, "--compression", compression, "--no-markers", "--imperfect"]
    bag = tmp_path / "deep" / "bag"
    assert main(["record", "--cell", str(demo.path), "--out", str(bag), "--plan", str(plan), *options]) == 0
    assert "2 configurations, 4 steps" in capsys.readouterr().out
    assert "/calibration/step" not in _topics(bag)


def test_configurations_beside_a_plan_are_refused(
    demo: Cell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bag"
    options = ["--plan", str(tmp_path / "plan.yaml"), "--configurations", "18"]
    assert main(["record", "--cell", str(demo.path), "--out", str(out), *options]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "--configurations: found an option that has no effect with --plan" in error
    assert not out.exists()


@pytest.mark.parametrize("fault", ["cell", "plan", "out", "table"])
def test_unusable_input_ends_with_two_and_one_line(
    demo: Cell, tmp_path: Path, fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = {"cell": demo.path, "out": tmp_path / "bag", "table": tmp_path / "table.csv"}
    culprit = tmp_path / "culprit"
    if fault in {"out", "table"}:
        culprit.mkdir()
    paths[fault] = culprit
    arguments = [text for key, path in paths.items() for text in (f"--{key}", str(path))]
    before = sorted(tmp_path.rglob("*"))
    assert main(["record", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert str(culprit) in error
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    "words",
    [
        ["record", "--out", "/dev/null/x"],
        ["record", "--out", "/proc/a/b"],
        ["record", "--out", "new/" + 300 * "a"],
        ["record", "--out", "new/bag", "--truth-out", "/proc/x.yaml"],
        ["record", "--out", "new/bag", "--table", "/proc/x.csv"],
        ["record", "--out", "new/bag", "--table", "new/bag"],
        ["record", "--out", "new/bag", "--table", "new/deep/table.csv", "--truth-out", "/dev/null/deep/x.yaml"],
        ["record", "--out", "old"],
    ],
)
def test_what_cannot_be_written_leaves_nothing(
    demo: Cell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old").touch()
    more = ["--cell", str(demo.path), "--configurations", "1"] if words[0] == "record" else []
    assert main([*words, *more]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "found" in error
    assert [path.name for path in tmp_path.rglob("*")] == ["old"]


def test_a_robot_that_cannot_carry_its_load_leaves_nothing(
    demo: Cell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise EquilibriumError(1.0, 50)

    monkeypatch.setattr("calibration_sim.cli.simulate_recording", broken)
    assert main(["record", "--cell", str(demo.path), "--out", str(tmp_path / "p"), "--configurations", "1"]) == 2
    assert capsys.readouterr().err.startswith(f"{demo.path}: found no static equilibrium")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        (["record", "--seed", "-1"], "'-1', expected an integer of at least 0"),
        (["record", "--seed", "x"], "'x', expected an integer of at least 0"),
        (["record", "--configurations", "0"], "'0', expected an integer of at least 1"),
        (["record", "--storage", "tape"], "expected one of"),
        (["record", "--storage", "sqlite3", "--compression", "lz4"], "exists for mcap alone"),
        (["record", "--table", ""], "an empty name"),
        (["record", "--bogus"], "calibration-sim record --help"),
        (["frob"], "expected one of"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(
    demo: Cell, tmp_path: Path, option: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = ["--cell", str(demo.path)] if option[0] == "record" else []
    with pytest.raises(SystemExit) as caught:
        main([option[0], *cell, "--out", str(tmp_path / "bag"), *option[1:]])
    assert caught.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert expected in error
    assert "_" not in error.partition("found")[2].partition("expected")[0]
    assert not (tmp_path / "bag").exists()
