"""Faults of the input are named, each with its remedy; recordings as they should be are never accused."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.input_checks.check import check_inputs
from calibration_core.input_checks.loaded import quarter_turns
from calibration_core.observations.observe import observe
from calibration_core.recording.table import write_table
from calibration_core.timeseries import Readings

ROOT = Path(__file__).resolve().parents[4]
REAL = next((one / "shared" / "data" / "real" for one in ROOT.parents if (one / "shared").is_dir()), ROOT / "none")
CELL = ROOT / "config" / "cells" / "small.cell.yaml"
Change = Callable[[Readings, Cell], tuple[Readings, Cell]]


@pytest.fixture(scope="module")
def good() -> tuple[Readings, Cell]:
    cell = load_cell(CELL)
    return observe(ROOT / "bags" / "small_loaded", cell), cell


def wrench(force: float = 1.0, torque: float = 1.0, turn: np.ndarray | None = None) -> Change:
    def change(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
        assert readings.wrench is not None
        axes = np.eye(3) if turn is None else turn
        parts = [force * readings.wrench[:, :3] @ axes.T, torque * readings.wrench[:, 3:] @ axes.T]
        return dataclasses.replace(readings, wrench=np.hstack(parts)), cell

    return change


def angles(order: tuple[int, ...] | None = None, factor: float = 1.0) -> Change:
    def change(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
        q = readings.q if order is None else readings.q[:, list(order)]
        return dataclasses.replace(readings, q=factor * q), cell

    return change


def positions(factor: float) -> Change:
    return lambda readings, cell: (dataclasses.replace(readings, position=factor * readings.position), cell)


def shuffled(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
    order = np.random.default_rng(1).permutation(len(readings))
    return dataclasses.replace(readings, position=readings.position[order]), cell


def points(order: tuple[int, ...]) -> Change:
    return lambda readings, cell: (dataclasses.replace(readings, point=np.array(order)[readings.point]), cell)


def mirrored(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
    there = {name: (-x, y, z) for name, (x, y, z) in cell.frames.measurement_points.items()}
    return readings, cell.model_copy(update={"frames": cell.frames.model_copy(update={"measurement_points": there})})


def read_in_base(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
    how = cell.measurements.model_copy(update={"wrench_axes": "base"})
    return readings, cell.model_copy(update={"measurements": how})


def test_good_recordings_are_not_accused(good: tuple[Readings, Cell]) -> None:
    assert check_inputs(*good) == ()


@pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not beside the project")
@pytest.mark.parametrize("table", sorted(REAL.glob("*.csv")), ids=lambda path: path.stem)
def test_real_recordings_are_not_accused(table: Path) -> None:
    cell = next(path for path in REAL.glob("*.cell.yaml") if table.stem.startswith(path.name.split(".", 1)[0]))
    assert check_inputs(observe(table, load_cell(cell)), load_cell(cell)) == ()


@pytest.mark.parametrize(
    ("change", "kind", "further"),
    [
        (wrench(-1.0, -1.0), "wrench_sign", {"factor": -1.0}),
        (wrench(1e-3, 1e-3), "wrench_unit", {"factor": 1000.0}),
        (wrench(1.0, 1e3), "wrench_unit", {"factor": 1e-3}),
        (read_in_base, "wrench_frame", {"axes": "in sensor axes, at the sensor"}),
        (angles((0, 2, 1, 3, 4, 5)), "joint_order", {"joints": ["joint_2", "joint_3"]}),
        (angles((0, 1, 2, 5, 4, 3)), "joint_order", {"joints": ["joint_4", "joint_6"]}),
        (angles(None, 180 / np.pi), "angle_unit", {"factor": np.pi / 180}),
        (positions(1e3), "position_unit", {"factor": 1e-3}),
        (positions(1e-3), "position_unit", {"factor": 1e3}),
        (points((1, 0, 2)), "point_order", {"points": ["mp1", "mp2"]}),
        (mirrored, "point_order", {"points": ["mp1", "mp2", "mp3"]}),
        (shuffled, "no_relation", {}),
    ],
)
def test_what_is_wrong_is_named(
    good: tuple[Readings, Cell], change: Change, kind: str, further: dict[str, object]
) -> None:
    found = check_inputs(*change(*good))
    assert [one.kind for one in found] == [kind]
    record = found[0].record()
    assert found[0].blocks
    assert record["remedy"]
    for key, value in further.items():
        assert record[key] == pytest.approx(value) if isinstance(value, float) else record[key] == value


def test_every_turn_of_the_axes_is_named(good: tuple[Readings, Cell]) -> None:
    turns = quarter_turns()
    assert len(turns) == 23
    for turn in turns:
        found = check_inputs(*wrench(turn=turn)(*good))
        assert [one.kind for one in found] == ["wrench_frame"]
        words = found[0].axes.split(", ")
        back = np.array([[(-1.0 if "-" in word else 1.0) * (word[-1] == axis) for axis in "xyz"] for word in words])
        np.testing.assert_allclose(back @ turn, np.eye(3))  # it takes the recorded axes back


@pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not beside the project")
@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (wrench(-1.0), "wrench_sign"), (wrench(1e-3), "wrench_unit"), (positions(1e3), "position_unit"),
        (positions(1e-3), "position_unit"), (positions(0.0), "no_relation"), (shuffled, "no_relation"),
        (angles((0, 2, 1, 3, 4, 5)), "joint_order"), (angles((0, 1, 2, 5, 4, 3)), "joint_order"),
        (angles(None, 180 / np.pi), "angle_unit"), (wrench(turn=quarter_turns()[5]), "wrench_frame"),
    ],
)  # fmt: skip
def test_a_real_recording_of_displacements(change: Change, kind: str) -> None:
    cell = load_cell(REAL / "fanuc.cell.yaml")
    found = check_inputs(*change(observe(REAL / "fanuc.csv", cell), cell))
    assert [one.kind for one in found] == [kind]


def test_computed_readings_are_told(good: tuple[Readings, Cell]) -> None:
    readings, cell = good
    stated = cell.instruments.tracker
    assert stated.sigma_range is not None
    assert stated.sigma_angle is not None
    louder = stated.model_copy(update={"sigma_range": 4 * stated.sigma_range, "sigma_angle": 4 * stated.sigma_angle})
    instruments = cell.instruments.model_copy(update={"tracker": louder})
    found = check_inputs(readings, cell.model_copy(update={"instruments": instruments}))
    assert [(one.kind, one.blocks) for one in found] == [("noise_overstated", False)]


@pytest.mark.parametrize("command", ["identify", "diagnose"])
@pytest.mark.parametrize("report", [False, True])
def test_both_commands_say_what_to_put_right(
    good: tuple[Readings, Cell], tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, report: bool
) -> None:
    table, out = tmp_path / "table.csv", tmp_path / "out"
    write_table(table, wrench(-1.0, -1.0)(*good)[0])
    arguments = [command, str(table), "--cell", str(CELL), "--out", str(out), *(() if report else ("--no-report",))]
    assert main(arguments) == 0
    assert capsys.readouterr().out.startswith("not usable: turn the sign of all forces and torques")
    assert {path.name for path in out.iterdir()} == (
        {"result.json", "report.html", "report.pdf"} if report else {"result.json"}
    )
    result = json.loads((out / "result.json").read_text())
    assert (result["usable"], result["verdict"], result["stiffness"], result["findings"]) == (
        "no",
        "unexplained",
        [],
        [],
    )
    assert result["anomalies"][0]["kind"] == "wrench_sign"
    assert result["anomalies"][0]["factor"] == -1.0
    assert "sign" in result["reason"]
    assert "sign" in result["next_step"]


def test_the_light_of_a_good_recording(tmp_path: Path) -> None:
    bag, out = ROOT / "bags" / "small_loaded", tmp_path / "out"
    lights = []
    for command in ("identify", "diagnose"):
        assert main([command, str(bag), "--cell", str(CELL), "--out", str(out), "--no-report"]) == 0
        result = json.loads((out / "result.json").read_text())
        lights.append(result["usable"])
        unmet = [one for one in result["preconditions"] if one["shall"] and one["met"] is False]
        assert (result["usable"] == "yes") is not bool(
            unmet or result["anomalies"] or result["verdict"] != "consistent"
        )
        assert result["reason"]
    assert lights[0] == lights[1]
