"""When the sequencer begins a motion, and when it does not: goals, permission, clients that are gone."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from calibration_interfaces.msg import Outcome, Permission, SampleCheck, SessionEvent
from diagnostic_msgs.msg import DiagnosticArray
from sequencer_world import CELL, GOAL, JOINTS, PULL, Operator, World, ended, overrides
from std_msgs.msg import String

from calibration.cell.permission import PermissionWatch
from calibration.sequencer.sequencer import SequencerNode
from calibration.topics import PROCEDURE, SAMPLE_CHECK, Quality, profile
from calibration_core.cell import load_cell
from calibration_core.files.yaml_file import yaml_text


@pytest.fixture
def world(spinning: Any) -> World:
    return World(spinning)


@pytest.fixture
def operator(spinning: Any) -> Operator:
    return Operator(spinning)


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.yaml"
    configurations = [{"number": 7, "q": GOAL, "steps": [[0.0] * 6, PULL]}]
    path.write_text(yaml_text({"schema": 1, "joints": JOINTS, "configurations": configurations}))
    return path


def test_what_cannot_be_begun_is_rejected(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    assert "no/such.yaml" in operator.rejected(until, tmp_path / "no" / "such.yaml", tmp_path / "session")
    assert "no session" in operator.rejected(until, plan, tmp_path / "session", resume=True)
    other = tmp_path / "other.yaml"
    other.write_text(plan.read_text().replace("joint_6", "axis_6"))
    assert "expected the cell's joints" in operator.rejected(until, other, tmp_path / "session")
    assert not (tmp_path / "session").exists()


def test_another_robot_than_the_cells_is_not_moved(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    told: list[str] = []
    world.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda one: told.extend(str(status.message) for status in one.status), 10
    )
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "first")  # nobody describes the robot: that is told, and no reason
    until(lambda: node.runner is not None)
    until(lambda: any(text.startswith("nothing comes on /robot_description") for text in told))
    text = load_cell(CELL).urdf_path.read_text("utf-8")
    described = world.node.create_publisher(String, "robot_description", profile(Quality.STATE))
    described.publish(String(data=text))
    time.sleep(1.5)
    assert not node.runner.sequence.paused
    other = re.sub(r'upper="[^"]*"', 'upper="0.9"', text, count=1)
    described.publish(String(data=other))  # another one, in the middle of a run
    until(lambda: node.runner.sequence.paused)
    until(lambda: "/robot_description is another robot than" in node.runner.sequence.snapshot().question)
    assert "limits of joint_1" in node.runner.sequence.snapshot().question
    assert operator.says("stop").success
    assert ended(handle).outcome.code == Outcome.STOPPED
    refused = operator.rejected(until, plan, tmp_path / "second")
    assert "/robot_description is another robot than" in refused
    described.publish(String(data=text))
    until(lambda: not node._description.fault)
    handle = operator.measure(plan, tmp_path / "second")
    assert handle.accepted
    until(lambda: node.runner is not None)
    assert operator.says("stop").success


def test_after_a_loss_of_permission_motion_is_resumed_by_name(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: node.runner is not None and node.runner.moving)
    world.permitted = False
    until(lambda: node.runner.sequence.held)
    assert operator.moves_on().code == Outcome.NOT_PERMITTED
    world.permitted = True
    until(lambda: operator.moves_on().code == Outcome.OK)
    until(lambda: node.runner.moving and not node.runner.sequence.held)
    world.permitted = False
    until(lambda: node.runner.sequence.held)
    world.permitted = True
    answer = operator.says("resume")
    assert (answer.success, "resume_motion" in answer.message) == (False, True)
    assert "name" in operator.moves_on(" ").text
    time.sleep(0.5)
    assert not node.runner.moving
    until(lambda: operator.moves_on().code == Outcome.OK)
    until(lambda: node.runner.moving)
    assert any(one.kind == SessionEvent.CONTINUED and one.text == "by A. Smith" for one in operator.events)
    handle.cancel_goal_async()
    assert ended(handle).outcome.code == Outcome.CANCELLED


def test_a_goal_accepted_without_permission_waits_for_the_operator(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    """Neither the reset of a latch nor drives that are switched on begin a motion."""
    world.permitted = False
    given = overrides(server_wait=0.5)
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=given))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: node.runner is not None and node.runner.sequence.held)
    world.permitted = True
    time.sleep(0.5)
    assert not node.runner.moving
    assert operator.moves_on().code == Outcome.OK
    until(lambda: node.runner.moving)
    handle.cancel_goal_async()
    assert ended(handle).outcome.code == Outcome.CANCELLED


def test_a_client_that_is_gone_pauses_the_run(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    operator.measure(plan, tmp_path / "session")
    until(lambda: node.runner is not None and node.runner.moving)
    time.sleep(0.5)
    assert not node.runner.sequence.paused
    operator.plan.destroy()
    until(lambda: node.runner.sequence.paused)
    assert operator.says("resume").success
    until(lambda: node.runner.moving)  # the operator minds it
    time.sleep(0.5)
    assert not node.runner.sequence.paused
    assert operator.says("stop").success
    until(lambda: node.runner is None)


def test_a_wrench_that_two_publish_pauses_the_run(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    checks = world.node.create_publisher(SAMPLE_CHECK.message, SAMPLE_CHECK.relative, SAMPLE_CHECK.qos)
    heard: list[Any] = []
    world.node.create_subscription(PROCEDURE.message, PROCEDURE.relative, heard.append, PROCEDURE.qos)
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: operator.steps)
    words = "/input/wrench is published by /driver, /old_driver"
    checks.publish(SampleCheck(name="wrench", problem=SampleCheck.TWO_SOURCES, text=words))
    until(lambda: heard and heard[-1].paused and words in heard[-1].question)
    operator.says("resume")
    time.sleep(0.5)
    assert heard[-1].paused
    checks.publish(SampleCheck(name="wrench", problem=SampleCheck.FINE))
    until(lambda: not node._equipment.fault(time.monotonic()))
    assert operator.says("resume").success
    until(lambda: not heard[-1].paused)
    assert operator.says("stop").success
    assert ended(handle).outcome.code == Outcome.STOPPED


@pytest.mark.parametrize(
    ("reasons", "ready"),
    [
        ((), True), ((Permission.STOP_UNPROVEN,), True), ((Permission.STOP_UNPROVEN, Permission.JOINTS_FROZEN), True),
        ((Permission.JOINTS_FROZEN,), False), ((Permission.STOP_UNPROVEN, Permission.LATCHED), False),
    ],
)  # fmt: skip
def test_a_missing_proof_alone_is_waited_for(reasons: tuple[int, ...], ready: bool) -> None:
    watch = PermissionWatch(1.0)
    watch.hear(Permission(permitted=not reasons, reasons=list(reasons)), 5.0)
    assert watch.ready(5.5) is ready
    assert (watch.against == 5.0) is not ready
    assert not watch.ready(6.5)
