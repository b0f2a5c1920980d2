"""The node `compensation`: both services as the command's numbers, every refusal, and which models it takes."""

from __future__ import annotations

import csv
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from builtin_interfaces.msg import Duration
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import CompensatePose, CompensateTrajectory
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3, Wrench
from rclpy.parameter import Parameter
from scipy.spatial.transform import Rotation
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from calibration.compensation import CompensationNode
from calibration_core.cell import load_cell
from calibration_core.cli import main
from calibration_core.errors import InputError
from calibration_core.model.identified.calibrated import ValidRange
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import model_text
from calibration_core.model.identified.named_values import value_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect

ROOT = Path(__file__).resolve().parents[3]
CELL = ROOT / "config" / "cells" / "small.cell.yaml"
Q = [0.3, -0.2, 0.4, 0.2, 0.9, 0.1]
PULL = Wrench(force=Vector3(x=20.0, y=-10.0, z=-50.0), torque=Vector3(x=1.0, y=0.0, z=0.5))
BACKLASH = AppliedEffect("backlash", {"joint": "joint_2"}, "load torque", {"gap": 1e-4, "reference_torque": 1e2})
GROWTH = AppliedEffect("thermal_growth", {"robot": "arm"}, "uniform", {"expansion": 1.2e-5})


def write_model(path: Path, *effects: AppliedEffect, cell: Path = CELL, covariance: bool = True) -> Path:
    """Write a model whose frames are a little off; joints alone have intervals."""
    known = load_cell(cell)
    parameters = nominal_parameters(known)
    geometry = np.random.default_rng(4).normal(0, 5e-4, (len(parameters.joints), 6))
    parameters = parameters.replace(geometry=geometry, effects=effects)
    names = tuple(f"compliance.{joint}" for joint in parameters.joints)
    value = np.array([value_of(parameters, name) for name in names])
    estimate = GaussianEstimate(names, ("rad/(N*m)",) * len(names), value, np.diag((0.01 * value) ** 2))
    covered = ValidRange(np.array([[-0.5, 1.5], *[[-3.2, 3.2]] * 5]), (0.0, 100.0), (0.0, 100.0), None)
    path.write_text(model_text(parameters, known, estimate if covariance else None, covered))
    return path


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return write_model(tmp_path / "model.yaml")


@pytest.fixture
def node(spinning: Any, model: Path) -> CompensationNode:
    return make(spinning, model)


def make(spinning: Any, model: Path | str, cell: Path = CELL) -> CompensationNode:
    given = [Parameter("cell", value=str(cell)), Parameter("model", value=str(model))]
    one: CompensationNode = spinning.add(CompensationNode(context=spinning.context, parameter_overrides=given))
    return one


def ask(spinning: Any, kind: Any, name: str, **fields: Any) -> Any:
    client = spinning.plain(f"client_{len(spinning.nodes)}").create_client(kind, f"/compensation/{name}")
    assert client.wait_for_service(60.0)
    return finish(client.call_async(kind.Request(**fields)))


def finish(future: Any, timeout: float = 60.0) -> Any:
    end = time.monotonic() + timeout
    while not future.done():
        assert time.monotonic() < end, "no answer"
        time.sleep(0.005)
    return future.result()


def ask_pose(spinning: Any, **fields: Any) -> Any:
    return ask(spinning, CompensatePose, "compensate_pose", **fields)


def ask_trajectory(spinning: Any, **fields: Any) -> Any:
    return ask(spinning, CompensateTrajectory, "compensate_trajectory", **fields)


def trajectory(
    q: np.ndarray, names: list[str], rates: np.ndarray | None = None, times: list[float] | None = None
) -> JointTrajectory:
    points = [JointTrajectoryPoint(positions=row.tolist()) for row in q]
    for k, point in enumerate(points):
        at = 0.5 * k if times is None else times[k]
        point.time_from_start = Duration(sec=int(at), nanosec=round(1e9 * (at - int(at))))
        if rates is not None:
            point.velocities = rates[k].tolist()
    return JointTrajectory(joint_names=names, points=points)


def command(model: Path, task: str, tmp_path: Path, *more: str) -> list[dict[str, str]]:
    """What the command line makes of a task."""
    (tmp_path / "task.csv").write_text(task)
    line = ["compensate", str(tmp_path / "task.csv"), "--cell", str(CELL), "--model", str(model)]
    out = tmp_path / "out"
    assert main([*line, "--out", str(out), "--no-report", *more]) == 0
    with (out / "compensated.csv").open() as file:
        return list(csv.DictReader(file))


def joint_names() -> list[str]:
    return [f"joint_{i}" for i in range(1, 7)]


def test_a_place_is_corrected_as_by_the_command_line(spinning: Any, node: Any, model: Path, tmp_path: Path) -> None:
    quaternion = Rotation.from_euler("xyz", [0.2, 1.5, -0.1])
    target = Pose(position=Point(x=0.7, y=0.1, z=0.6),
                  orientation=Quaternion(**dict(zip("xyzw", quaternion.as_quat().tolist(), strict=True))))  # fmt: skip
    names = ["joint_6", *joint_names()[:5]]
    answer = ask_pose(
        spinning, target=target, joints=names, q=[Q[5], *Q[:5]], wrench=PULL, payload_mass=2.0,
        payload_centre=Point(x=0.01, y=0.0, z=0.05),
    )  # fmt: skip
    assert (answer.outcome.code, answer.status) == (Outcome.OK, "ok"), answer.outcome.text
    seeds = ",".join(map(str, Q))
    (row,) = command(
        model,
        "x,y,z,roll,pitch,yaw,q1,q2,q3,q4,q5,q6,fx,fy,fz,tx,ty,tz\n"
        f"0.7,0.1,0.6,0.2,1.5,-0.1,{seeds},20,-10,-50,1,0,0.5\n",
        tmp_path,
        "--payload", "2 0.01 0 0.05",
    )  # fmt: skip
    assert list(answer.joints) == joint_names()
    np.testing.assert_allclose(answer.q, [float(row[f"q{i}"]) for i in range(1, 7)], atol=1e-9)
    place = answer.corrected.position
    np.testing.assert_allclose([place.x, place.y, place.z], [float(row[f"c{a}"]) for a in "xyz"], atol=1e-9)
    turn = answer.corrected.orientation
    sent = Rotation.from_euler("xyz", [float(row[f"c{a}"]) for a in ("roll", "pitch", "yaw")])
    assert (Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]) * sent.inv()).magnitude() < 1e-8
    for name in ("error_before", "error_after", "u95"):
        assert getattr(answer, name) == pytest.approx(float(row[name]), rel=1e-6, abs=1e-9)
    assert answer.error_before > 1e-4 > 1e-6 > answer.error_after
    assert list(answer.outside) == []
    (remark,) = answer.remarks  # the model has no covariance of its geometry
    assert remark.startswith("The geometry was not identified")


def test_the_place_of_joint_angles_and_what_lies_outside(spinning: Any, node: Any, model: Path, tmp_path: Path) -> None:
    q = [-0.8, *Q[1:]]
    answer = ask_pose(spinning, target_of_joints=True, q=q, wrench=PULL, axes="tool")
    head = ",".join(f"q{i}" for i in range(1, 7))
    (row,) = command(model, f"{head},fx,fy,fz,tx,ty,tz\n{','.join(map(str, q))},20,-10,-50,1,0,0.5\n", tmp_path,
                     "--axes", "tool")  # fmt: skip
    np.testing.assert_allclose(answer.q, [float(row[f"q{i}"]) for i in range(1, 7)], atol=1e-9)
    assert list(answer.outside) == ["joints"]


def test_a_trajectory_keeps_its_order_of_joints_and_its_times(
    spinning: Any, node: Any, model: Path, tmp_path: Path
) -> None:
    times = np.arange(5) / 2
    q = np.array(Q) + 0.1 * np.sin(times)[:, None]
    rates = 0.1 * np.cos(times)[:, None] * np.ones(6)
    rates[[0, -1]] = 0.0
    names = joint_names()
    order = [5, 0, 1, 2, 3, 4]
    asked = trajectory(q[:, order], [names[k] for k in order], rates[:, order])
    asked.header.frame_id = "base"
    answer = ask_trajectory(spinning, trajectory=asked, wrenches=[PULL])
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    assert list(answer.status) == ["ok"] * 5
    head = ",".join(["time", "path", *(f"q{i}" for i in range(1, 7))])
    lines = [f"{t},a,{','.join(map(str, row.tolist()))}" for t, row in zip(times, q, strict=True)]
    rows = command(model, "\n".join([head, *lines]) + "\n", tmp_path, "--wrench", "20 -10 -50 1 0 0.5")
    expected = np.array([[float(row[f"q{i}"]) for i in range(1, 7)] for row in rows])
    found = answer.trajectory
    assert found.header.frame_id == "base"
    assert list(found.joint_names) == [names[k] for k in order]
    np.testing.assert_allclose([one.positions for one in found.points], expected[:, order], atol=1e-9)
    assert [one.time_from_start for one in found.points] == [one.time_from_start for one in asked.points]
    given = np.array([one.velocities for one in found.points])
    assert np.all(given[[0, -1]] == 0.0)
    change = np.gradient(expected - q, times, axis=0)
    np.testing.assert_allclose(given[1:-1], (rates + change)[1:-1][:, order], atol=1e-9)
    assert np.abs(change[1:-1]).max() > 1e-6
    np.testing.assert_allclose(answer.u95, [float(row["u95"]) for row in rows], rtol=1e-6)
    assert len(answer.corrected) == len(answer.error_before) == len(answer.error_after) == 5


def test_one_wrench_per_point_none_and_no_velocities(spinning: Any, node: Any) -> None:
    asked = trajectory(np.tile(Q, (2, 1)), joint_names())
    both = ask_trajectory(spinning, trajectory=asked, wrenches=[PULL, Wrench()])
    none = ask_trajectory(spinning, trajectory=asked)
    assert both.outcome.code == none.outcome.code == Outcome.OK
    positions = [np.array([one.positions for one in answer.trajectory.points]) for answer in (both, none)]
    assert np.abs(positions[0][0] - positions[1][0]).max() > 1e-6
    np.testing.assert_allclose(positions[0][1], positions[1][1], atol=1e-9)
    assert all(len(one.velocities) == 0 for one in both.trajectory.points)


def test_a_point_that_is_refused_refuses_the_trajectory(spinning: Any, node: Any) -> None:
    heavy = Wrench(force=Vector3(x=0.0, y=0.0, z=-5e4))
    asked = trajectory(np.tile(Q, (2, 1)), joint_names())
    answer = ask_trajectory(spinning, trajectory=asked, wrenches=[PULL, heavy])
    assert answer.outcome.code == Outcome.NOT_REACHED
    assert answer.outcome.text == "point 1: load beyond the rated load; 1 refused"
    assert list(answer.status) == ["ok", "load beyond the rated load"]
    assert len(answer.trajectory.points) == 0 == len(answer.corrected)
    assert np.isnan(answer.error_after[1])
    far = ask_pose(spinning, target=Pose(position=Point(x=9.0, y=0.0, z=0.0)))
    assert (far.outcome.code, far.status) == (Outcome.NOT_REACHED, "out of reach")
    assert len(far.q) == 0 == len(far.joints)


def test_a_trajectory_that_is_too_fast_is_not_answered(spinning: Any, node: Any) -> None:
    """As it is given, by the velocities between its points alone, or where a correction steps: 250 mm/s hold."""
    fast = np.array([Q, [Q[0] + 0.2, *Q[1:]]])
    swings = np.array([[0.0] * 6, [3.0, *[0.0] * 5]])
    still, names = np.tile(Q, (2, 1)), joint_names()
    for asked, wrenches, without in (
        (trajectory(fast, names, times=[0.0, 0.2]), [PULL], "[0-9]{3,}"),
        (trajectory(still, names, swings, [0.0, 0.5]), [PULL], "[0-9]{3,}"),
        (trajectory(still, names, times=[0.0, 1e-5]), [Wrench(), PULL], "0"),
    ):
        answer = ask_trajectory(spinning, trajectory=asked, wrenches=wrenches)
        assert answer.outcome.code == Outcome.INPUT_UNUSABLE
        assert re.fullmatch(
            r"request: trajectory\.points\[1\]: found [a-z0-9 /]+ at up to [0-9.]+ mm/s on the way there "
            rf"\({without}\.[0-9] mm/s without the correction\), expected at most 250 mm/s .*",
            answer.outcome.text,
        ), answer.outcome.text
        assert len(answer.trajectory.points) == 0 == len(answer.corrected)
    slow = ask_trajectory(spinning, trajectory=trajectory(fast, names, times=[0.0, 2.0]), wrenches=[PULL])
    assert slow.outcome.code == Outcome.OK, slow.outcome.text


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"axes": "world"}, "axes: found 'world', expected one of base, tool"),
        ({"payload_mass": -1.0}, "payload_mass: found -1"),
        ({"payload_centre": Point(x=float("nan"), y=0.0, z=0.0)}, "payload: found nan"),
        ({"temperature": [float("inf")]}, "temperature: found inf"),
        ({"q": [0.0, 1.0]}, "q: found 2 values, expected 6"),
        ({"q": [float("nan")] * 6}, "q: found nan"),
        ({"q": [30.0] * 6}, "q: found joint_1 at 30, far beyond the limits"),
        ({"joints": ["joint_1", "x"], "q": [0.0, 1.0]}, "joints: found 'joint_1, x', expected each of joint_1"),
        ({"joints": [f"joint_{i}" for i in range(1, 7)], "q": [0.0]}, "q: found 1 values, expected 6"),
        ({"target_of_joints": True}, "q: found nothing"),
        ({"wrench": Wrench(force=Vector3(x=float("nan"), y=0.0, z=0.0))}, "wrench: found nan"),
        ({"target": Pose(position=Point(x=float("inf"), y=0.0, z=0.0))}, "target.position: found inf"),
        ({"target": Pose(orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))}, "a quaternion of length 0"),
        ({"target": Pose(orientation=Quaternion(w=float("nan")))}, "a quaternion of length nan"),
    ],
)
def test_a_place_that_makes_no_sense(spinning: Any, node: Any, fields: dict[str, Any], words: str) -> None:
    answer = ask_pose(spinning, **fields)
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert words in answer.outcome.text
    assert "\n" not in answer.outcome.text
    assert len(answer.q) == 0


SHORT = trajectory(np.zeros((1, 6)), joint_names())
SHORT.points[0].positions = [0.0] * 5
HALF = trajectory(np.zeros((2, 6)), joint_names(), np.zeros((2, 6)))
HALF.points[1].velocities = []


@pytest.mark.parametrize(
    ("asked", "wrenches", "words"),
    [
        (trajectory(np.zeros((0, 6)), joint_names()), [], "trajectory.points: found 0 points"),
        (trajectory(np.zeros((1, 6)), joint_names()[:5]), [], "trajectory.joint_names: found"),
        (trajectory(np.zeros((1, 6)), [*joint_names()[:5], "joint_1"]), [], "each of joint_1"),
        (SHORT, [], "trajectory.points[0].positions: found 5 values"),
        (HALF, [], "trajectory.points[1].velocities: found 0 values"),
        (trajectory(np.full((1, 6), np.nan), joint_names()), [], "trajectory.points: found nan"),
        (trajectory(np.zeros((2, 6)), joint_names(), np.full((2, 6), np.nan)), [], "trajectory.points: found nan"),
        (trajectory(np.array([[0.0] * 6, [45.0] * 6]), joint_names()), [], "points[1]: found joint_1 at 45, far"),
        (trajectory(np.zeros((2, 6)), joint_names(), times=[1.0, 1.0]), [], "points[1].time_from_start: found 1 s"),
        (trajectory(np.zeros((3, 6)), joint_names()), [PULL, PULL], "wrenches: found 2 wrenches, expected 3"),
    ],
)
def test_a_trajectory_that_makes_no_sense(
    spinning: Any, node: Any, asked: JointTrajectory, wrenches: list[Wrench], words: str
) -> None:
    answer = ask_trajectory(spinning, trajectory=asked, wrenches=wrenches)
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert words in answer.outcome.text
    assert len(answer.trajectory.points) == 0


def test_no_load_without_a_wrench_point(spinning: Any, tmp_path: Path) -> None:
    content = yaml.safe_load(CELL.read_text())
    del content["frames"]["wrench_point"]
    (tmp_path / "bare.cell.yaml").write_text(yaml.safe_dump(content))
    cell = tmp_path / "bare.cell.yaml"
    make(spinning, write_model(tmp_path / "model.yaml", cell=cell), cell)
    answer = ask_pose(spinning, target_of_joints=True, q=Q, wrench=PULL)
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert "frames.wrench_point" in answer.outcome.text


def test_models_that_say_less_or_more(spinning: Any, tmp_path: Path) -> None:
    """Without covariance there is no interval; an effect that lacks what it needs is named, and compensated with it."""
    make(spinning, write_model(tmp_path / "one.yaml", BACKLASH, GROWTH, covariance=False))
    cold = ask_pose(spinning, target_of_joints=True, q=Q, wrench=PULL)
    assert cold.outcome.code == Outcome.OK, cold.outcome.text
    assert any("thermal growth" in one for one in cold.remarks)
    warm = ask_pose(spinning, target_of_joints=True, q=Q, wrench=PULL, temperature=[35.0])
    assert not any("thermal growth" in one for one in warm.remarks)


def test_no_model_yet_then_one_then_another_robots(spinning: Any, model: Path, tmp_path: Path, until: Any) -> None:
    node = make(spinning, "")
    answer = ask_pose(spinning, target_of_joints=True, q=Q)
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert answer.outcome.text == "model: found nothing, expected a model file as parameter of the node"
    (taken,) = node.set_parameters([Parameter("model", value=str(model))])
    assert taken.successful, taken.reason
    good = ask_pose(spinning, target_of_joints=True, q=Q, wrench=PULL)
    assert good.outcome.code == Outcome.OK
    other = tmp_path / "other.yaml"
    demo = write_model(tmp_path / "demo.yaml", cell=CELL.parent / "demo.cell.yaml")
    text = model.read_text()
    sha = yaml.safe_load(text)["robot_sha256"]
    for content, words in (
        (text.replace(sha, "0" * 64), "robot_sha256"),
        (text.replace("joint_6", "joint_7"), "joints"),
        (demo.read_text(), "robot"),
        ("schema: 9\n", "schema"),
    ):
        other.write_text(content)
        (refused,) = node.set_parameters([Parameter("model", value=str(other))])
        assert not refused.successful
        assert words in refused.reason
        assert "\n" not in refused.reason
        assert node.value("model") == str(model)
        assert list(ask_pose(spinning, target_of_joints=True, q=Q, wrench=PULL).q) == list(good.q)
    (gone,) = node.set_parameters([Parameter("model", value=str(tmp_path / "nowhere.yaml"))])
    assert not gone.successful
    (none,) = node.set_parameters([Parameter("model", value="")])
    assert none.successful
    assert ask_pose(spinning, target_of_joints=True, q=Q).outcome.code == Outcome.INPUT_UNUSABLE


def test_another_set_up_of_the_same_robot_is_accepted(spinning: Any, model: Path, tmp_path: Path) -> None:
    """Frames, points and instruments are those of the cell; the robot alone must be the same."""
    content = yaml.safe_load(CELL.read_text())
    content["name"] = "another hall"
    content["frames"]["tracker"] = {"xyz": [9.0, 8.0, 7.0], "rpy": [0.0, 0.0, 1.0]}
    content["instruments"]["tracker"] = {"sigma": 1e-4}
    (tmp_path / "hall.cell.yaml").write_text(yaml.safe_dump(content))
    make(spinning, model, tmp_path / "hall.cell.yaml")
    assert ask_pose(spinning, target_of_joints=True, q=Q, wrench=PULL).outcome.code == Outcome.OK


def test_a_node_with_another_robots_model_does_not_start(spinning: Any, tmp_path: Path) -> None:
    demo = write_model(tmp_path / "demo.yaml", cell=CELL.parent / "demo.cell.yaml")
    with pytest.raises(InputError, match=r"demo\.yaml:3:8: robot: found"):
        make(spinning, demo)


def test_one_request_at_a_time_and_no_change_of_the_model_meanwhile(spinning: Any, node: Any, model: Path) -> None:
    with node._working:
        assert ask_pose(spinning, target_of_joints=True, q=Q).outcome.code == Outcome.BUSY
        (refused,) = node.set_parameters([Parameter("model", value=str(model))])
        assert refused.reason == "model: not now: a compensation is under way"
    assert ask_pose(spinning, target_of_joints=True, q=Q).outcome.code == Outcome.OK
