"""Faults of the input are named, each with its remedy; recordings as they should be are never accused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from input_cases import CELL, REAL, ROOT, Change, columns, deflections, in_other_axes, left_handed, wrench
from scipy.spatial.transform import Rotation

from calibration_core.cell import Cell, Pose, load_cell
from calibration_core.cli import main
from calibration_core.files.yaml_file import yaml_text
from calibration_core.identification.identify import identify
from calibration_core.input_checks.anomaly import unit_anomaly
from calibration_core.input_checks.check import check_inputs, unit_note
from calibration_core.input_checks.placed import PositionRecording, check_positions
from calibration_core.input_checks.wrench_axes import quarter_turns
from calibration_core.model.chain import pose_matrix
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.observations.observe import observe, observe_recording
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import Readings
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import Scenario
from calibration_sim.scenarios.measure import Noise


@pytest.fixture(scope="module")
def good() -> tuple[Readings, Cell]:
    cell = load_cell(CELL)
    return observe(ROOT / "bags" / "small_loaded", cell), cell


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
        *((left_handed(k), "point_order", {"points": ["mp1", "mp2", "mp3"], "axes": f"-{'xyz'[k]}"}) for k in range(3)),
        (left_handed(1, stated=False), "point_order", {"points": ["mp1", "mp2", "mp3"]}),
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


@pytest.mark.parametrize("off", [0.0, 0.1])
def test_an_angle_with_another_in_it_is_named_and_the_key_heals_it(
    good: tuple[Readings, Cell], tmp_path: Path, off: float
) -> None:
    """The pendant of FANUC counts joint 3 against the floor; a target may stand elsewhere besides."""
    readings, cell = good
    q = readings.q.copy()
    q[:, 2] -= q[:, 1]
    there = {name: (x + off, y, z) for name, (x, y, z) in cell.frames.measurement_points.items()}
    cell = cell.model_copy(update={"frames": cell.frames.model_copy(update={"measurement_points": there})})
    (found,) = check_inputs(dataclasses.replace(readings, q=q), cell)
    assert (found.kind, found.joints) == ("joint_coupling", ("joint_2", "joint_3"))
    assert "state robot.joint_coupling: {joint_3: {joint_2: 1}} in the cell file" in found.remedy
    write_table(tmp_path / "pendant.csv", dataclasses.replace(readings, q=q))
    stated = (
        tmp_path / "cell.yaml",
        CELL.read_text(encoding="utf-8").replace("robot:", "robot:\n  joint_coupling: {joint_3: {joint_2: 1}}", 1),
    )
    stated[0].write_text(stated[1], encoding="utf-8")
    read = observe(tmp_path / "pendant.csv", load_cell(stated[0]))
    np.testing.assert_allclose(read.q, readings.q, atol=1e-12)


@pytest.mark.parametrize("off", [0.1, 0.2, 0.4])
def test_a_target_that_stands_elsewhere_accuses_nothing(off: float) -> None:
    """Points are refitted by every identification, so they are refitted before a relation is denied."""
    chain = chain_of(load_cell(CELL))
    for seed in range(5):
        draw = np.random.default_rng(seed)
        q = np.repeat(draw.uniform(-1.0, 1.0, (24, 6)), 2, axis=0)
        point = np.tile([0, 1], 24)
        stated = draw.normal(scale=0.1, size=(2, 3))
        true = stated + np.array([[off, 0.0, 0.0], [0.0, 0.0, -off]])
        seen = posture(chain, q).point(true[point].T).T @ pose_matrix(np.ones(3), draw.normal(size=3))[:3, :3].T
        noise = draw.normal(scale=2e-5, size=seen.shape)
        for loaded in (False, True):
            recording = PositionRecording(chain, q, seen + noise, point, stated, ("mp1", "mp2"), loaded)
            assert check_positions(recording) == []


@pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not beside the project")
@pytest.mark.parametrize("name", ["wam_random", "ur5_grid", "ur10_D", "motoman"])
def test_left_handed_readings_of_real_recordings_are_named(name: str) -> None:
    cell = load_cell(next(path for path in REAL.glob("*.cell.yaml") if name.startswith(path.name.split(".", 1)[0])))
    readings, cell = left_handed(1)(observe(REAL / f"{name}.csv", cell), cell)
    (found,) = check_inputs(readings, cell)
    assert found.kind == "point_order"
    assert found.remedy.startswith("the sign of one coordinate of the readings is wrong: ")


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize(
    ("change", "factor", "words"),
    [
        (wrench(1e-3, 1.0), 1000.0, "multiply the forces by 1000: they look like kN"),
        (wrench(1.0, 1e3), 1e-3, "multiply the torques by 0.001: they look like N·mm"),
    ],
)
def test_sizes_decide_whether_forces_or_torques_have_the_wrong_unit(
    good: tuple[Readings, Cell], change: Change, factor: float, words: str, stated: bool
) -> None:
    readings, cell = good
    if not stated:
        cell = cell.model_copy(update={"robot": cell.robot.model_copy(update={"stiffness": None})})
    changed, cell = change(readings, cell)
    (found,) = check_inputs(changed, cell)
    assert (found.kind, found.factor) == ("wrench_unit", pytest.approx(factor))
    assert found.remedy.startswith(words)
    assert found.factor is not None
    parts = (factor, 1.0) if "forces by" in found.remedy else (1.0, factor)
    assert check_inputs(*wrench(*parts)(changed, cell)) == ()  # the remedy heals it


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


def test_readings_that_repeat_each_other_are_told(good: tuple[Readings, Cell]) -> None:
    """Loads too small to be seen, and no noise either."""
    readings, cell = good
    assert readings.wrench is not None
    keys = np.column_stack([readings.configuration, readings.point])
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    still = readings.position[first][group.reshape(-1)]
    changed = dataclasses.replace(readings, position=still, q=readings.q[first][group.reshape(-1)],
                                  wrench=1e-3 * readings.wrench)  # fmt: skip
    stated = cell.robot.model_copy(update={"stiffness": None})
    found = check_inputs(changed, cell.model_copy(update={"robot": stated}))
    assert [(one.kind, one.blocks) for one in found] == [("noise_overstated", False)]


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
    said = [line for line in capsys.readouterr().out.splitlines() if not line.endswith("% done)")]
    assert said[0].startswith("not usable: turn the sign of all forces and torques")
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


def test_messages_that_claim_base_axes_are_held_against_the_motion() -> None:
    cell = load_cell(CELL)
    recording = read_bag(ROOT / "bags" / "small_loaded", cell)
    assert recording.wrench is not None
    claiming = dataclasses.replace(recording.wrench, frame="base_link")
    readings = observe_recording(dataclasses.replace(recording, wrench=claiming), cell)
    assert [note.text for note in readings.notes if note.kind == "wrench_axes"] == [
        "the messages carry the frame 'base_link', the cell file says that the wrench is in sensor axes"
    ]
    assert check_inputs(readings, cell) == ()  # the motion says that the cell file is right
    assert readings.wrench is not None
    turned = dataclasses.replace(readings, wrench=_in_base_axes(readings, cell))
    assert [(one.kind, one.axes) for one in check_inputs(turned, cell)] == [
        ("wrench_frame", "in base axes, at the sensor")
    ]
    still = dataclasses.replace(readings, wrench=0.01 * readings.wrench, position=_unmoved(readings, cell))
    assert [one.kind for one in check_inputs(still, cell)] == ["wrench_frame"]  # where nothing can tell, it is asked
    unclaimed = dataclasses.replace(still, notes=())
    assert not any(one.blocks for one in check_inputs(unclaimed, cell))


def _in_base_axes(readings: Readings, cell: Cell) -> np.ndarray:
    at = posture(chain_of(cell), readings.q)
    assert readings.wrench is not None
    assert cell.frames.force_torque is not None
    sensor = pose_matrix(np.array(cell.frames.force_torque.xyz), np.array(cell.frames.force_torque.rpy))[:3, :3]
    origin = at.point(np.zeros((3, len(readings)))).T
    axes = np.stack([at.point(np.repeat(row[:, None], len(readings), axis=1)).T - origin for row in sensor.T], axis=-1)
    return np.hstack([np.einsum("mij,mj->mi", axes, part) for part in np.split(readings.wrench, 2, axis=1)])


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_a_test_recording_of_another_robot_is_refused(
    good: tuple[Readings, Cell], tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    readings, _ = good
    table, other, out = tmp_path / "table.csv", tmp_path / "other.csv", tmp_path / "out"
    write_table(table, readings)
    scaled = readings.position * np.array([1.0, 1.0, 1.3])  # the arm of another robot reaches elsewhere
    write_table(other, dataclasses.replace(readings, position=scaled))
    arguments = [command, str(table), "--cell", str(CELL), "--test", str(other), "--out", str(out), "--no-report"]
    assert main(arguments) == 0
    assert capsys.readouterr().out.startswith("not usable: use the file of this robot")
    (anomaly,) = json.loads((out / "result.json").read_text())["anomalies"]
    assert anomaly["kind"] == "wrong_robot_file"
    assert anomaly["text"].startswith("in the test recording: ")


@pytest.mark.parametrize("command", ["plan", "simulate", "predict"])
def test_a_cell_file_in_millimetres_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    text = CELL.read_text().replace("xyz: [2.5, -0.4, 0.6]", "xyz: [2500.0, -400.0, 600.0]")
    (tmp_path / "cell.yaml").write_text(text)
    bag = str(ROOT / "bags" / "small_loaded")
    further = {"plan": [], "simulate": ["--plan", "none.yaml"], "predict": [bag, "--model", "none.yaml"]}[command]
    assert main([command, *further, "--cell", str(tmp_path / "cell.yaml"), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "frames.tracker.xyz: 2,602 m" in said
    assert "multiply frames.tracker.xyz by 0.001" in said


def test_the_note_on_units_says_what_they_are_judged_by(good: tuple[Readings, Cell]) -> None:
    readings, cell = good
    assert unit_note(readings, cell) is None
    unstated = cell.model_copy(update={"robot": cell.robot.model_copy(update={"stiffness": None})})
    note = unit_note(readings, unstated)
    assert note is not None
    assert "a common factor below 100 cannot be seen" in note.text
    assert readings.wrench is not None
    still = dataclasses.replace(readings, wrench=1e-3 * readings.wrench, position=_unmoved(readings, cell))
    note = unit_note(still, cell)
    assert note is not None
    assert "the unit cannot be checked" in note.text


def _unmoved(readings: Readings, cell: Cell) -> np.ndarray:
    points = np.array([cell.frames.measurement_points[name] for name in readings.points])[readings.point]
    at = posture(chain_of(cell), readings.q).point(points.T).T
    tracker = cell.frames.tracker
    assert tracker is not None
    pose = pose_matrix(np.array(tracker.xyz), np.array(tracker.rpy))
    return (at - pose[:3, 3]) @ pose[:3, :3]


@pytest.mark.parametrize(
    ("size", "strength", "stated", "kind", "factor"),
    [
        (1000.0, 1e-3, False, "wrench_unit", 1000.0),
        (1000.0, 0.9, False, "position_unit", 1e-3),
        (9.5, 0.1, True, "wrench_unit", 9.80665),
        (40.0, 0.9, True, "position_unit", 0.0254),
        (1e-3, 0.9, True, "position_unit", 1e3),
    ],
)
def test_the_unit_is_named_by_the_factor(size: float, strength: float, stated: bool, kind: str, factor: float) -> None:
    (found,) = unit_anomaly(size, strength, stated=stated)
    assert found.kind == kind
    assert found.factor == pytest.approx(factor)


@pytest.mark.parametrize("size", [0.2, 1.0, 5.0])
def test_a_robot_softer_or_stiffer_than_stated_is_no_matter_of_units(size: float) -> None:
    assert unit_anomaly(size, 1.0, stated=True) == []
    assert unit_anomaly(8 * size, 1.0, stated=False) == []


@pytest.mark.slow
def test_the_light_is_the_same_where_few_loaded_configurations_stand_beside_many_others(tmp_path: Path) -> None:
    noise = Noise(1.0, False, 0.0, spherical_claim=False)
    played = generate(Scenario(0, "nothing", "light", "L2A40", 780, (), 0.0, noise))
    cell, table, out = tmp_path / "cell.yaml", tmp_path / "table.csv", tmp_path / "out"
    cell.write_text(yaml_text(played.cell), encoding="utf-8")
    write_table(table, played.readings)
    lights = []
    for command in ("identify", "diagnose"):
        assert main([command, str(table), "--cell", str(cell), "--out", str(out), "--no-report"]) == 0
        result = json.loads((out / "result.json").read_text())
        lights.append([result[key] for key in ("usable", "reason", "next_step", "verdict")])
    assert lights[0] == lights[1]
    assert lights[0][0] == "with_reservations"
    assert "at least 12 manipulator configurations" in lights[0][1]


def test_the_zero_of_the_first_joint_cannot_be_told_and_changes_no_stiffness(good: tuple[Readings, Cell]) -> None:
    """It turns robot and tracker frame together: with the wrench in sensor axes nothing else sees it."""
    readings, cell = good
    turned = dataclasses.replace(readings, q=readings.q + 0.05 * np.eye(readings.q.shape[1])[0])
    assert check_inputs(turned, cell) == ()
    before, after = (identify(one, cell) for one in (readings, turned))
    values = [[joint.value for joint in found.stiffness] for found in (before, after)]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-4)
    assert after.fit.rms_after == pytest.approx(before.fit.rms_after, rel=1e-4)


# --- axes and units of wrenches and displacements ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (columns((2, 1, 0, 3, 4, 5)), "the axes of the forces are z, y, x of"),
        (columns((0, 2, 1, 3, 4, 5)), "the axes of the forces are x, z, y of"),
        (columns((1, 2, 0, 3, 4, 5)), "the axes of the forces are z, x, y of"),
        (columns((1, 0, 2, 4, 3, 5)), "the axes of the wrench are y, x, z of"),
        (columns((0, 1, 2, 3, 4, 5), (-1, 1, 1, 1, 1, 1)), "the axes of the forces are -x, y, z of"),
        (columns((0, 1, 2, 3, 4, 5), (1, -1, 1, 1, -1, 1)), "the axes of the wrench are x, -y, z of"),
        (columns((0, 1, 2, 3, 4, 5), (1, -1, 1, -1, 1, -1)), "the axes of the wrench are x, -y, z of"),
    ],
)
def test_columns_of_the_wrench_that_are_exchanged_or_turned_are_named(
    good: tuple[Readings, Cell], change: Change, words: str
) -> None:
    """They had been called another unit, another robot, or nothing at all."""
    (found,) = check_inputs(*change(*good))
    assert found.kind == "wrench_frame"
    assert words in found.text


def test_axes_of_the_torques_alone_are_named(tmp_path: Path) -> None:
    noise = Noise(1.0, False, 0.0, spherical_claim=False)
    played = generate(Scenario(0, "nothing", "light", "L", 780, (), 0.0, noise))
    (tmp_path / "cell.yaml").write_text(yaml_text(played.cell), encoding="utf-8")
    recorded = played.readings, load_cell(tmp_path / "cell.yaml")
    assert check_inputs(*recorded) == ()
    for order, signs, axes in (
        ((0, 1, 2, 5, 4, 3), (1,) * 6, "z, y, x"),
        ((0, 1, 2, 4, 3, 5), (1,) * 6, "y, x, z"),
        ((0, 1, 2, 3, 4, 5), (1, 1, 1, 1, -1, 1), "x, -y, z"),
        ((0, 1, 2, 3, 4, 5), (1, 1, 1, -1, -1, -1), "-x, -y, -z"),
    ):
        (found,) = check_inputs(*columns(order, signs)(*recorded))
        assert (found.kind, found.axes) == ("wrench_frame", axes)
        assert f"the axes of the torques are {axes} of the recorded ones" in found.text


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_displacements_in_other_axes_are_named(good: tuple[Readings, Cell], stated: bool, seed: int) -> None:
    """Another robot or a joint's zero is not accused; the stated axes heal it."""
    readings, cell = deflections(*good)
    turn = Rotation.random(random_state=seed).as_matrix()
    turned, cell = in_other_axes(readings, cell, turn, stated=stated)
    (found,) = check_inputs(turned, cell)
    assert (found.kind, found.location) == ("no_relation", {"tracker": "tracker"})
    assert "frames.tracker" in found.remedy
    rpy = tuple(map(float, found.axes.removeprefix("rpy [").removesuffix("]").split(",")))
    pose = (cell.frames.tracker or Pose(xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0))).model_copy(update={"rpy": rpy})
    frames = cell.frames.model_copy(update={"tracker": pose})
    assert check_inputs(turned, cell.model_copy(update={"frames": frames})) == ()


@pytest.mark.parametrize("axis", range(3))
def test_mirrored_displacements_are_named(good: tuple[Readings, Cell], axis: int) -> None:
    readings, cell = left_handed(axis)(*deflections(*good))
    (found,) = check_inputs(readings, cell)
    assert (found.kind, found.axes) == ("point_order", f"-{'xyz'[axis]}")
    assert f"turn the sign of {'xyz'[axis]} of all displacements" in found.remedy


def test_mirrored_displacements_in_axes_that_nobody_states(good: tuple[Readings, Cell]) -> None:
    """Which coordinate it is, is not known then; and mirrored displacements may be a wrench of the wrong sign."""
    for axis, kind in ((0, "point_order"), (1, "point_order"), (2, "wrench_sign")):
        (found,) = check_inputs(*left_handed(axis, stated=False)(*deflections(*good)))
        assert (found.kind, found.axes) == (kind, "")


def test_displacements_in_slightly_other_axes_are_left_to_the_diagnosis(good: tuple[Readings, Cell]) -> None:
    readings, cell = deflections(*good)
    turn = Rotation.from_rotvec([0.05, 0.1, -0.08]).as_matrix()
    assert check_inputs(*in_other_axes(readings, cell, turn, stated=True)) == ()


@pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not beside the project")
def test_real_displacements_in_other_axes_are_named() -> None:
    cell = load_cell(REAL / "fanuc.cell.yaml")
    readings = observe(REAL / "fanuc.csv", cell)
    for seed in range(3):
        turn = Rotation.random(random_state=seed).as_matrix()
        for mirror, kind in ((np.eye(3), "no_relation"), (np.diag([1.0, -1.0, 1.0]), "point_order")):
            found = check_inputs(*in_other_axes(readings, cell, mirror @ turn, stated=True))
            assert [one.kind for one in found] == [kind]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Readings, Cell]:
    """A recording that shows differences of less than ten times between forces and torques."""
    noise = Noise(1.0, False, 0.0, spherical_claim=False)
    played = generate(Scenario(0, "nothing", "heavy", "L", 781, (), 0.0, noise))
    path = tmp_path_factory.mktemp("many") / "cell.yaml"
    path.write_text(yaml_text(played.cell), encoding="utf-8")
    return played.readings, load_cell(path)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize(
    ("force", "torque", "words"),
    [
        (1 / 9.80665, 1.0, "multiply the forces by 9.80665: they look like kgf (daN: by 10)"),
        (0.1, 1.0, "multiply the forces by 9.80665: they look like kgf (daN: by 10)"),
        (1 / 4.44822, 1.0, "multiply the forces by 4.44822: they look like lbf"),
        (1.0, 1 / 9.80665, "multiply the torques by 9.80665: they look like kgf·m"),
        (1.0, 1 / 0.112985, "multiply the torques by 0.112985: they look like lbf·in"),
    ],
)
def test_units_that_are_less_than_a_thousand_apart_are_named(
    recorded: tuple[Readings, Cell], force: float, torque: float, words: str, *, stated: bool
) -> None:
    readings, cell = recorded
    assert check_inputs(readings, cell) == ()
    if not stated:
        cell = cell.model_copy(update={"robot": cell.robot.model_copy(update={"stiffness": None})})
    (found,) = check_inputs(*wrench(force, torque)(readings, cell))
    assert found.kind == "wrench_unit"
    assert found.remedy.startswith(words)
