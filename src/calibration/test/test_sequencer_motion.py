"""When the sequencer begins a motion, and when it does not: goals, permission, clients that are gone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from calibration_interfaces.msg import (
    Outcome,
    SessionEvent,
)
from sequencer_world import GOAL, JOINTS, PULL, Operator, World, ended, overrides

from calibration.sequencer import SequencerNode
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
    until(lambda: node.runner.moving)
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
