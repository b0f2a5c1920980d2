"""A simulation with conventions of its own: they are named, put right, and the comparison is the same as without."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from robots import loaded_readings
from scipy.spatial.transform import Rotation

from calibration_core.cell import Cell
from calibration_core.commands.evaluation.diagnose import Diagnosed, evaluate_all
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.diagnosis.comparison.points import rigid
from calibration_core.diagnosis.comparison.recordings import sensor_axes
from calibration_core.diagnosis.comparison.result import Comparison
from calibration_core.diagnosis.simulated import compare_checked
from calibration_core.errors import RecordingError
from calibration_core.fleet.next_robot.population_file import TypePopulation
from calibration_core.fleet.pooling import Population
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.observe import observe
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import Readings


def simulated(recorded: Readings, cell: Cell) -> Readings:
    return dataclasses.replace(recorded, position=predict_readings(recorded, cell, nominal_parameters(cell)))


@pytest.fixture(scope="module")
def plain(recorded: Readings, cell: Cell) -> Comparison:
    return compare_checked(recorded, simulated(recorded, cell), cell)


def reaction(readings: Readings, _: Cell) -> Readings:
    assert readings.wrench is not None
    return dataclasses.replace(readings, wrench=-readings.wrench)


def in_base_axes(readings: Readings, cell: Cell) -> Readings:
    assert readings.wrench is not None
    axes, parts = sensor_axes(readings, cell, chain_of(cell)), (readings.wrench[:, :3], readings.wrench[:, 3:])
    return dataclasses.replace(readings, wrench=np.hstack([np.einsum("mij,mj->mi", axes, part) for part in parts]))


def in_degrees(readings: Readings, _: Cell) -> Readings:
    return dataclasses.replace(readings, q=np.degrees(readings.q))


def in_another_order(readings: Readings, _: Cell) -> Readings:
    return dataclasses.replace(readings, q=readings.q[:, [0, 1, 2, 4, 3, 5]])


def other_sign(readings: Readings, _: Cell) -> Readings:
    return dataclasses.replace(readings, q=readings.q * [1, 1, -1, 1, 1, 1])


def other_zero(readings: Readings, _: Cell) -> Readings:
    return dataclasses.replace(readings, q=readings.q + np.array([0, 0.3, 0, 0, 0, 0]))


def in_millimetres(readings: Readings, cell: Cell) -> Readings:
    return dataclasses.replace(reaction(readings, cell), position=1e3 * readings.position)


def without_wrench(readings: Readings, _: Cell) -> Readings:
    return dataclasses.replace(readings, wrench=None)


def zero_wrench(readings: Readings, _: Cell) -> Readings:
    assert readings.wrench is not None
    return dataclasses.replace(readings, wrench=0 * readings.wrench)


def without_weight(readings: Readings, cell: Cell) -> Readings:
    robot = cell.robot.model_copy(update={"gravity": (0.0, 0.0, 0.0)})
    return simulated(readings, cell.model_copy(update={"robot": robot}))


@pytest.mark.parametrize(
    ("foreign", "kinds"),
    [
        (reaction, {"wrench_sign"}),
        (in_base_axes, {"wrench_frame"}),
        (in_degrees, {"angle_unit"}),
        (in_another_order, {"joint_order"}),
        (other_sign, {"wrong_robot_file"}),
        (other_zero, {"wrong_robot_file"}),
        (in_millimetres, {"position_unit", "wrench_sign"}),
        (without_wrench, {"loads"}),
        (zero_wrench, {"loads"}),
        (without_weight, {"gravity"}),
    ],
)
def test_a_convention_is_named_and_put_right(
    foreign: Callable[[Readings, Cell], Readings],
    kinds: set[str],
    recorded: Readings,
    plain: Comparison,
    cell: Cell,
) -> None:
    found = compare_checked(recorded, foreign(simulated(recorded, cell), cell), cell)
    assert {one.kind for one in found.differences} == kinds
    assert {(one.side, one.spoils) for one in found.differences} == {("simulation", False)}
    assert all(one.remedy in one.text for one in found.differences)
    assert found.witnesses == ()
    assert found.steps is not None
    assert plain.steps is not None
    assert found.steps.rms == pytest.approx(plain.steps.rms, rel=0.02)


def test_a_simulation_that_does_not_bend_is_the_rigid_robot(recorded: Readings, cell: Cell) -> None:
    rigid = simulated(dataclasses.replace(recorded, wrench=None), cell)
    found = compare_checked(recorded, rigid, cell)
    assert ["rigid" in one.text for one in found.differences] == [True]
    assert found.reproduction.compliance is not None
    assert not found.reproduction.compliance.any()
    assert found.steps is not None


def same(readings: Readings, _: Cell) -> Readings:
    return readings


def shuffled(readings: Readings, _: Cell) -> Readings:
    return dataclasses.replace(readings, position=readings.position[::-1])


def every_answer(recorded: Readings, cell: Cell) -> Iterator[Diagnosed | Refusal]:
    """Answers of every kind that a diagnosis beside simulations has."""
    simulation = simulated(recorded, cell)
    for foreign in (same, in_millimetres, without_weight, zero_wrench, shuffled):
        answer = evaluate_all([recorded], [cell], Options(), simulations=[foreign(simulation, cell)])
        yield answer
        if isinstance(answer, Diagnosed):
            sisters = dict.fromkeys(cell.robot.joints, Population(13.0, 0.1, 1e-4, 1e-4, 100))
            yield dataclasses.replace(answer, population=TypePopulation("file", "abc", "kr", sisters, {}, "a plant"))
    for wrong in (reaction, in_degrees, in_another_order, in_millimetres):
        yield evaluate_all([wrong(recorded, cell)], [cell], Options(), simulations=[simulation])
    second = loaded_readings(cell, 4)
    named = dataclasses.replace(second.provenance, path="second.csv", sha256={"second.csv": "second"})
    both = [recorded, dataclasses.replace(second, provenance=named)]
    for change in (same, reaction):
        changed = [change(one, cell) for one in both]
        yield evaluate_all(changed, [cell] * 2, Options(), simulations=[simulated(one, cell) for one in both])


def test_every_answer_fits_a_terminal(recorded: Readings, cell: Cell) -> None:
    seen = set()
    for answer in every_answer(recorded, cell):
        seen.add(type(answer))
        lines = answer.content["summary"]
        assert answer.summary.splitlines() == lines
        pairs = len(answer.diagnosis.comparisons) if isinstance(answer, Diagnosed) else 1
        assert len(lines) < 12 * pairs  # the report's place follows
        assert max(map(len, lines)) <= 120, lines
    assert seen == set(get_args(get_type_hints(evaluate_all)["return"]))


def rewritten(path: Path, named: dict[str, tuple[str, float]]) -> None:
    """Give columns of a table another name and unit."""
    with path.open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    for name, (_, factor) in named.items():
        k = header.index(name)
        for row in rows:
            row[k] = repr(factor * float(row[k]))
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows([[named.get(name, (name,))[0] for name in header], *rows])


def millimetres(path: Path, readings: Readings, _: Cell) -> None:
    write_table(path, readings)
    rewritten(path, {axis: (axis, 1e3) for axis in "xyz"})


def stated_millimetres(path: Path, readings: Readings, _: Cell) -> None:
    write_table(path, readings)
    angles = {f"q{i}": (f"q{i} [deg]", 180 / np.pi) for i in range(1, 7)}
    rewritten(path, {axis: (f"{axis} [mm]", 1e3) for axis in "xyz"} | angles)


def torques_in_newton_millimetres(path: Path, readings: Readings, _: Cell) -> None:
    write_table(path, readings)
    rewritten(path, {name: (name, 1e3) for name in ("tx", "ty", "tz")})


def poses(
    path: Path, readings: Readings, cell: Cell, turn: tuple[str, ...], unit: dict[str, tuple[str, float]]
) -> None:
    """Write one row for each step: the pose of the tool, which carries the points, in the base frame."""
    model, points = nominal_parameters(cell), np.stack([cell.frames.measurement_points[p] for p in readings.points])
    count = len(points)
    position = (readings.position @ model.tracker[:3, :3].T + model.tracker[:3, 3]).reshape(-1, count, 3)
    header = [
        "configuration",
        "step",
        *(f"q{i}" for i in range(1, 7)),
        "fx",
        "fy",
        "fz",
        "tx",
        "ty",
        "tz",
        *"xyz",
        *turn,
    ]
    assert readings.wrench is not None
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        for k, seen in zip(range(0, len(readings), count), position, strict=True):
            axes, shift, _ = rigid(seen, points)
            assert cell.frames.wrench_point is not None
            rotation, place = Rotation.from_matrix(axes), axes @ np.array(cell.frames.wrench_point) + shift
            turned = rotation.as_quat() if len(turn) == 4 else rotation.as_euler("xyz")
            numbers = np.concatenate([readings.q[k], readings.wrench[k], place, turned])
            writer.writerow([readings.configuration[k], readings.step[k], *map(repr, numbers.tolist())])
    rewritten(path, unit)


def tool_poses(path: Path, readings: Readings, cell: Cell) -> None:
    poses(path, readings, cell, ("roll", "pitch", "yaw"), {})


def tool_quaternions(path: Path, readings: Readings, cell: Cell) -> None:
    poses(path, readings, cell, ("qx", "qy", "qz", "qw"), {axis: (f"{axis} [mm]", 1e3) for axis in "xyz"})


@pytest.mark.parametrize(
    ("write", "kinds"),
    [
        (millimetres, ["position_unit"]),
        (stated_millimetres, []),
        (torques_in_newton_millimetres, ["wrench_unit"]),
        (tool_poses, []),
        (tool_quaternions, []),
    ],
)
def test_a_table_of_another_program_is_compared(
    write: Callable[[Path, Readings, Cell], None],
    kinds: list[str],
    recorded: Readings,
    plain: Comparison,
    cell: Cell,
    tmp_path: Path,
) -> None:
    table = tmp_path / "simulation.csv"
    write(table, simulated(recorded, cell), cell)
    found = compare_checked(recorded, observe(table, cell, simulated=True), cell)
    assert [one.kind for one in found.differences] == kinds
    assert found.steps is not None
    assert plain.steps is not None
    assert found.steps.rms == pytest.approx(plain.steps.rms, rel=1e-6)


@pytest.mark.parametrize("factor", [3.0, np.nan])
def test_a_quaternion_that_is_none_is_named(recorded: Readings, cell: Cell, tmp_path: Path, factor: float) -> None:
    table = tmp_path / "poses.csv"
    tool_quaternions(table, recorded, cell)
    rewritten(table, {"qw": ("qw", factor)})
    with pytest.raises(RecordingError, match=r"line 2, column qw|line 2, column qx qy qz qw: found a length of"):
        observe(table, cell, simulated=True)
