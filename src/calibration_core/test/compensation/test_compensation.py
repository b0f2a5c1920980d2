"""A task is compensated row by row: derivatives, arrival, history, refusals, tables."""

from __future__ import annotations

import csv
import io
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration_core.cell import Cell
from calibration_core.compensation.compensate import Compensation, compensate
from calibration_core.compensation.deflection import QUANTILE, deflect
from calibration_core.compensation.inverse import axes_of, rpy_of_axes, turning
from calibration_core.compensation.motion import covariance_of, length_bound, tool_columns, tool_movement
from calibration_core.compensation.robot import CalibratedRobot, Conditions, parts_of, with_payload
from calibration_core.compensation.tables import compensated_csv, times_of, trajectory_yaml
from calibration_core.compensation.task import Task, places, read_task
from calibration_core.errors import TaskError
from calibration_core.model.chain import rotation_rpy
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import value_of, with_values
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.model.statics import gravity_torque
from calibration_core.outcomes.compensation import apply

BEARING = AppliedEffect(
    "off_axis_compliance",
    {"joint": "joint_2"},
    "before",
    {"compliance_x": 2e-7, "compliance_y": 1e-7, "compliance_xy": 0.0},
)
WAVE = AppliedEffect("transmission_error", {"joint": "joint_3"}, "order 2", {"sine": 1e-4, "cosine": 2e-4})
APPROACH = AppliedEffect("approach_direction", {"joint": "joint_1"}, "sign", {"half_width": 1e-4})
GROWTH = AppliedEffect("thermal_growth", {"robot": "arm"}, "uniform", {"expansion": 1.2e-5})
GAIN = AppliedEffect("wrench_gain", {"sensor": "force_torque"}, "fy", {"gain_fy": 0.01})
LOW, HIGH = [-1.2, -0.4, -0.5, -1.5, 0.4, -1.5], [1.2, 0.6, 0.7, 1.5, 1.4, 1.5]


def model_of(cell: Cell, *effects: AppliedEffect) -> ModelParameters:
    """Return a model whose geometry is half a millimetre and half a milliradian off."""
    geometry = np.random.default_rng(4).normal(0, 5e-4, (6, 6))
    return nominal_parameters(cell).replace(geometry=geometry, effects=effects)


def estimate_of(model: ModelParameters) -> GaussianEstimate:
    names = [f"compliance.{joint}" for joint in model.joints]
    names += [f"geometry.{joint}.{kind}" for joint in model.joints[1:] for kind in ("x", "y", "z", "rx", "ry", "rz")]
    names += [f"tracker.{part}" for part in ("x", "y", "z", "roll", "pitch", "yaw")]
    names += [f"measurement_points.mp1.{axis}" for axis in "xyz"]
    names += [f"effects.{k}.{name}" for k, effect in enumerate(model.effects) for name in effect.parameters]
    value = np.array([value_of(model, name) for name in names])
    std = np.where([name.startswith(("compliance", "effects.0")) for name in names], 1e-8, 2e-5)
    return GaussianEstimate(tuple(names), ("1",) * len(names), value, np.diag(std**2))


def task_of(m: int, seed: int = 1) -> Task:
    rng = np.random.default_rng(seed)
    force = rng.normal(0, 700, (m, 3))
    force *= np.minimum(1.0, 1800 / np.linalg.norm(force, axis=1))[:, None]
    return places(q=rng.uniform(LOW, HIGH, (m, 6)), wrench=np.hstack([force, rng.normal(0, 50, (m, 3))]))


def conditions_of(task: Task) -> Conditions:
    return Conditions(task.time, task.temperature, task.path)


def place_in_tracker(cell: Cell, model: ModelParameters, task: Task) -> tuple[np.ndarray, np.ndarray]:
    """Return the tool's origin (m, 3) and axes (3, 3, m), tracker frame, of the tool at mp1."""
    robot = CalibratedRobot.of(cell, model).at_point("mp1")
    load = robot.load(task.wrench)
    rest = robot.stand(task.q, load)
    parts = tuple(parts_of(robot, task.q, load, rest, conditions_of(task)))
    moved = tool_movement(robot, parts, len(task))
    origin, axes = robot.places(rest)
    turned = np.stack([one + np.cross(moved[:, 3:], one.T).T for one in axes])
    tracker = model.tracker
    return (origin.T + moved[:, :3] - tracker[:3, 3]) @ tracker[:3, :3], np.einsum(
        "ba,kbm->kam", tracker[:3, :3], turned
    )


def test_the_columns_of_everything_identified_are_the_differences(cell: Cell) -> None:
    model, task = model_of(cell, BEARING, WAVE), task_of(8)
    robot, estimate = CalibratedRobot.of(cell, model).at_point("mp1"), estimate_of(model)
    load = robot.load(task.wrench)
    rest = robot.stand(task.q, load)
    parts = tuple(parts_of(robot, task.q, load, rest, conditions_of(task)))
    columns = tool_columns(robot, rest, parts, estimate)
    base = model.tracker[:3, :3]
    for p, name in enumerate(estimate.names):
        step = 1e-9 if name.startswith(("compliance", "effects.0")) else 1e-6
        (ahead, axes_ahead), (behind, axes_behind) = (
            place_in_tracker(cell, with_values(model, {name: estimate.value[p] + sign * step}), task)
            for sign in (1, -1)
        )
        moved = (ahead - behind) @ base.T / (2 * step)
        turned = (base @ turning(axes_behind, axes_ahead)).T / (2 * step)
        found, expected = columns[:, :, p], np.hstack([moved, turned])
        size = np.abs(expected).max() + np.abs(columns[:, :, p]).max()
        assert np.abs(found - expected).max() < 0.01 * size, name  # geometry: the load's torques by it are left out
        if name.startswith(("compliance", "tracker", "measurement")):
            assert np.abs(found - expected).max() < 2e-3 * size, name


def test_every_row_arrives_from_angles_and_from_places(cell: Cell) -> None:
    model, task = model_of(cell, BEARING, WAVE), task_of(60)
    robot, estimate = CalibratedRobot.of(cell, model), estimate_of(model)
    found = compensate(robot, task, estimate)
    assert found.ok.all()
    assert np.linalg.norm(found.error_before, axis=1).min() > 1e-4
    assert np.linalg.norm(found.error_after, axis=1).max() < 1e-7
    assert np.all((found.u95 > 1e-6) & (found.u95 < 1e-2))
    assert np.abs(found.q - found.nominal).max() < 0.05
    pose = np.hstack([found.target.T, rpy_of_axes(found.axes)])
    seeded = Task((), ((),) * 60, task.q, pose, task.wrench, task.temperature, task.time, task.path)
    again = compensate(robot, seeded, estimate)
    np.testing.assert_allclose(again.q, found.q, atol=1e-8)
    anywhere = compensate(robot, places(pose=pose, wrench=task.wrench), estimate)
    assert anywhere.ok.mean() > 0.9
    np.testing.assert_allclose(anywhere.target[:, anywhere.ok], found.target[:, anywhere.ok], atol=1e-12)
    assert np.linalg.norm(anywhere.error_after[anywhere.ok], axis=1).max() < 1e-7


def test_the_branch_is_kept_along_a_path_of_places(cell: Cell) -> None:
    robot = CalibratedRobot.of(cell, model_of(cell))
    share = np.linspace(0.0, 1.0, 80)[:, None]
    q = (1 - share) * np.array([-1.2, -0.3, 0.6, 1.4, 1.2, -1.4]) + share * np.array([1.2, 0.5, -0.4, -1.4, 0.7, 1.4])
    there = compensate(robot, places(q=q), None)
    pose = np.hstack([there.target.T, rpy_of_axes(there.axes)])
    along = compensate(robot, places(pose=pose, one_path=True), None, seed_q=q[0])
    assert np.abs(np.diff(along.nominal, axis=0)).max() < 0.3
    assert along.ok.all()
    np.testing.assert_allclose(along.nominal, q, atol=1e-6)


def test_a_load_in_tool_axes_and_a_payload_are_what_they_say(cell: Cell) -> None:
    model, task = model_of(cell), task_of(5)
    robot = CalibratedRobot.of(cell, model)
    axes = np.moveaxis(robot.places(robot.stand(task.q, None))[1], -1, 0)  # (m, axis, base)
    inside = np.hstack([np.einsum("mab,mb->ma", axes, task.wrench[:, part]) for part in (slice(0, 3), slice(3, 6))])
    first = deflect(robot, task.q, task.wrench, conditions_of(task), None)
    second = deflect(robot, task.q, inside, conditions_of(task), None, "tool")
    np.testing.assert_allclose(second.moved, first.moved, rtol=0.02, atol=1e-6)  # the wrench turns with the tool
    np.testing.assert_allclose(second.compliance, first.compliance, rtol=0.02, atol=2e-9)  # base axes, either way
    np.testing.assert_allclose(second.stiffness()[0], first.stiffness()[0], rtol=0.01)
    loaded = with_payload(robot.chain, (100.0, 0.0, 0.1, 0.2))
    at = posture(robot.chain, task.q)
    weight = gravity_torque(loaded, at) - gravity_torque(robot.chain, at)
    lever = at.point(np.array([0.0, 0.1, 0.2])) - at.origin[1]
    expected = np.einsum("am,am->m", at.axis(1), np.cross(lever.T, 100.0 * robot.chain.gravity).T)
    np.testing.assert_allclose(weight[1], expected, rtol=1e-9)


def test_history_temperature_and_what_is_of_the_measurement(cell: Cell) -> None:
    model = model_of(cell, APPROACH, GROWTH, GAIN)
    robot = CalibratedRobot.of(cell, model)
    q = np.tile(np.array([0.0, 0.1, 0.1, 0.2, 0.8, 0.3]), (4, 1))
    q[:, 0] = [0.0, 0.1, 0.2, 0.1]  # there, further, and back
    path = places(q=q, one_path=True)
    alone = compensate(robot, places(q=q), None)
    found = compensate(robot, path, None)
    assert {effect.effect for effect in alone.aside} == {"approach_direction", "thermal_growth", "wrench_gain"}
    assert {effect.effect for effect in found.aside} == {"thermal_growth", "wrench_gain"}
    change = found.q[:, 0] - alone.q[:, 0]
    np.testing.assert_allclose(change, [0.0, -1e-4, -1e-4, 1e-4], atol=2e-6)
    warm = Task((), ((),) * 4, q, None, path.wrench, np.full(4, 30.0), path.time, path.path)
    hot = compensate(robot, warm, None)
    assert {effect.effect for effect in hot.aside} == {"wrench_gain"}
    assert np.linalg.norm(hot.error_before - found.error_before, axis=1).max() > 1e-4


def test_rows_are_refused_by_name_and_the_others_done(cell: Cell) -> None:
    good = np.array([0.0, 0.1, 0.1, 0.2, 0.8, 0.3])
    q = np.tile(good, (4, 1))
    q[1, 4], q[2, 1] = 0.0, 3.0
    wrench = np.zeros((4, 6))
    wrench[3, 2] = -1e5
    found = compensate(CalibratedRobot.of(cell, model_of(cell)), places(q=q, wrench=wrench), None)
    assert found.status == ("ok", "near a singularity", "beyond the limits of joint_2", "load beyond the rated load")
    assert np.isnan(found.u95).all()
    far = places(pose=np.array([[9.0, 0, 0, 0, 0, 0]]))
    assert compensate(CalibratedRobot.of(cell, model_of(cell)), far, None).status == ("out of reach",)


def test_intervals_of_deflections_are_those_of_repeated_draws(cell: Cell) -> None:
    model, task = model_of(cell, BEARING), task_of(2)
    estimate = estimate_of(model)
    found = deflect(CalibratedRobot.of(cell, model), task.q, task.wrench, conditions_of(task), estimate)
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(60):
        value = estimate.value + estimate.root() @ rng.standard_normal(len(estimate.names))
        other = with_values(model, dict(zip(estimate.names, value, strict=True)))
        draws.append(deflect(CalibratedRobot.of(cell, other), task.q, task.wrench, conditions_of(task), None).moved)
    tool = found.names.index("tool")
    np.testing.assert_allclose(QUANTILE * np.std(draws, axis=0)[:, tool], found.u95[:, tool], rtol=0.3, atol=2e-7)
    stiff, axes = found.stiffness()
    assert np.all(np.diff(stiff, axis=1) >= 0)
    softest = np.einsum("mab,mb->ma", found.compliance, axes[:, 0])
    np.testing.assert_allclose(np.linalg.norm(softest, axis=1), 1 / stiff[:, 0], rtol=0.02)


def test_the_bound_of_a_length_holds_nineteen_of_twenty() -> None:
    rng = np.random.default_rng(2)
    for scales in ([1.0, 1.0, 1.0], [1.0, 0.1, 0.01], [3.0, 2.0, 0.0]):
        bound = length_bound(np.diag(np.square(scales))[None])[0]
        errors = np.linalg.norm(rng.standard_normal((200_000, 3)) * scales, axis=1)
        assert np.mean(errors <= bound) == pytest.approx(0.95, abs=0.006)
    unknown = GaussianEstimate(("a",), ("m",), np.zeros(1), np.array([[np.inf]]))
    columns = np.array([[[1.0], [0.0], [0.0]], [[0.0], [0.0], [0.0]]])
    assert length_bound(covariance_of(columns, unknown)).tolist() == [np.inf, 0.0]


def test_axes_and_angles() -> None:
    rpy = np.random.default_rng(3).uniform(-1.4, 1.4, (20, 3))
    axes = axes_of(rpy)
    np.testing.assert_allclose(axes[:, :, 0].T, rotation_rpy(*rpy[0]), atol=1e-15)
    np.testing.assert_allclose(rpy_of_axes(axes), rpy, atol=1e-12)


def _rows(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode())))


def _compensated(cell: Cell, path: Path) -> tuple[Task, Compensation]:
    task = read_task(path, cell)
    return task, compensate(CalibratedRobot.of(cell, model_of(cell)), task, None)


def test_tables_hold_the_task_and_its_corrections(cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "task.csv"
    path.write_text(
        "fx,fy,fz,tx,ty,tz,path,time,q1,q2,q3,q4,q5,q6\n"
        "0,0,-500,0,0,0,a,10.0,0,0.1,0.1,0.2,0.8,0.3\n"
        "0,0,-500,0,0,0,a,12.5,0.1,0.1,0.1,0.2,0.8,0.3\n"
        "0,0,-500,0,0,0,,13,0,0.1,0.1,0.2,0,0.3\n"
    )
    task, found = _compensated(cell, path)
    assert task.path.tolist() == [0, 0, -1]
    rows = _rows(compensated_csv(task, found))
    assert [row["status"] for row in rows] == ["ok", "ok", "near a singularity"]
    assert [float(rows[0][f"q{j}"]) for j in range(1, 7)] == found.q[0].tolist()
    assert (rows[2]["q1"], rows[2]["cx"], rows[2]["fz"]) == ("", "", "-500")
    ok = np.flatnonzero(found.ok)
    times = apply(CalibratedRobot.of(cell, model_of(cell)), CalibratedModel(model_of(cell), None, None), task).time
    trajectory = yaml.safe_load(trajectory_yaml(cell.robot.joints, found, times))
    assert [point["time_from_start"] for point in trajectory["points"]] == [
        {"sec": 0, "nanosec": 0}, {"sec": 2, "nanosec": 500_000_000}
    ]  # fmt: skip
    untimed = times_of(found.q[ok], np.full((1, 6), 2.0), 0.25)
    assert untimed[1] == pytest.approx(2.0 * np.abs(np.diff(found.q[ok], axis=0)).sum() / 0.25)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", "line 1"),
        ("q1,q2\n0,0\n", "line 1"),
        ("x,y,z,roll,pitch,yaw,surprise\n1,2,3,0,0,0,0\n", "line 1"),
        ("x,y,z,roll,pitch,yaw,x\n1,2,3,0,0,0,0\n", "line 1"),
        ("fx,fy,fz,tx,ty,tz\n1,2,3,0,0,0\n", "line 1"),
        ("x,y,z,roll,pitch,yaw\n", ""),
        ("x,y,z,roll,pitch,yaw\n1,2,3\n", "line 2"),
        ("x,y,z,roll,pitch,yaw\n1,2,3,0,0,nan\n", "line 2, column yaw"),
        ("x,y,z,roll,pitch,yaw\n\n1,2,1_0,0,0,0\n", "line 3, column z"),
        ("x,y,z,roll,pitch,yaw,temperature\n1,2,3,0,0,0,warm\n", "line 2, column temperature"),
        ("x,y,z,roll,pitch,yaw,time\n1,2,3,0,0,0,2\n1,2,3,0,0,0,\n\n1,2,3,0,0,0,1\n", "line 5, column time"),
        ("x,y,z,roll,pitch,yaw,time\n1,2,3,0,0,0,2\n1,2,3,0,0,0,2\n", "line 3, column time"),
    ],
)
def test_every_fault_of_a_task_is_named(cell: Cell, tmp_path: Path, text: str, place: str) -> None:
    path = tmp_path / "task.csv"
    path.write_text(text)
    with pytest.raises(TaskError) as caught:
        read_task(path, cell)
    assert caught.value.place == place
    assert "\n" not in str(caught.value)


def test_the_time_grows_with_the_rows_alone(cell: Cell) -> None:
    model = model_of(cell, BEARING)
    robot, estimate = CalibratedRobot.of(cell, model), estimate_of(model)
    spent = []
    for m in (250, 2000):
        task = task_of(m)
        begin = time.process_time()
        compensate(robot, task, estimate)
        spent.append(time.process_time() - begin)
    assert spent[1] < 12 * spent[0]


def test_a_model_without_geometry_says_that_places_rest_on_the_cell_file(cell: Cell) -> None:
    model = model_of(cell)
    whole = estimate_of(model)
    alone = whole.chosen([k for k, name in enumerate(whole.names) if not name.startswith("geometry.")])
    robot, task = CalibratedRobot.of(cell, model), task_of(2)
    said = [apply(robot, CalibratedModel(model, one, None), task).remarks for one in (whole, alone, None)]
    assert [any("geometry was not identified" in text for text in texts) for texts in said] == [False, True, False]
    assert any("states no covariance" in text for text in said[2])
