"""Guard and sequencer as managed nodes: what is latched stays latched, and a run's parameters stay as they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import ResetGuard
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from stand_ins import CELL, Feed, call

from calibration.guard.guard import GuardNode
from calibration.lifecycle.machine import ACTIVATE, CLEANUP, CONFIGURE, DEACTIVATE
from calibration.sequencer.goal import Goal
from calibration.sequencer.parameters import FREE, PARAMETERS
from calibration.sequencer.sequencer import SequencerNode
from calibration_core.motion.robot_status import Reason

JOINTS = [f"joint_{i}" for i in range(1, 7)]


def guard(spinning: Any) -> GuardNode:
    given = [Parameter("cell", value=str(CELL)), Parameter("motion.backend", value="simulated")]
    one: GuardNode = spinning.add(GuardNode(context=spinning.context, parameter_overrides=given))
    return one


def jump(node: GuardNode) -> None:
    """Let the joints make a change that no motion can make."""
    for angle in (0.0, 3.0):
        node._on_joints(JointState(name=JOINTS, position=[angle] * 6), None)
    node._decide(0.0)


def latched(node: GuardNode) -> bool:
    assert node._last is not None
    return Reason.JOINTS_JUMPED in node._last.latched


@pytest.mark.parametrize("way", [(DEACTIVATE, ACTIVATE), (DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE)])
def test_no_transition_releases_what_is_latched(
    spinning: Any, until: Any, feeds: list[Any], way: tuple[int, ...]
) -> None:
    node = guard(spinning)
    jump(node)
    until(lambda: latched(node))
    joints = spinning.plain("driver").create_publisher(JointState, "joint_states", 10)
    feeds.append(Feed(joints, lambda _: JointState(name=JOINTS, position=[3.0] * 6)))  # the robot stands
    until(node._joints.standing)
    for transition in way:
        assert node.change(transition), node.trouble
    until(lambda: node._last is not None and latched(node))
    assert not node._last.permitted
    client = spinning.plain().create_client(ResetGuard, "guard/reset")
    answer = call(client, ResetGuard.Request(operator_name="A. Miller"))
    assert answer.outcome.code == Outcome.NOT_PERMITTED  # nothing is known of the robot any more


def test_a_guard_that_is_activated_again_wants_the_stop_proven_again(spinning: Any, until: Any) -> None:
    node = guard(spinning)
    before = node.guard
    assert node.change(DEACTIVATE)
    assert node._last is not None
    assert Reason.STOPPING in node._last.reasons
    assert node.change(ACTIVATE)
    until(lambda: node._last is not None)
    assert node.guard is not before
    assert not node.guard.proof.proven
    assert node._received == {}


def test_parameters_of_a_run_change_between_runs_alone(spinning: Any) -> None:
    usual = {"cell": str(CELL), "motion.backend": "external", "force_torque": "", "recorder": "", "progress": False}
    given = [Parameter(name, value=value) for name, value in usual.items()]
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=given))
    assert {one.name for one in PARAMETERS if not one.read_only} == FREE
    assert node.set_parameters([Parameter("settle_time", value=2.5)])[0].successful
    assert not node.set_parameters([Parameter("settle_time", value=-1.0)])[0].successful
    assert not node.set_parameters([Parameter("permission_age", value=0.9)])[0].successful
    node.runs.goal = Goal(None, lambda: None)  # as while a plan is measured
    answer = node.set_parameters([Parameter("settle_time", value=0.0)])[0]
    assert (answer.successful, answer.reason) == (False, "settle_time: not now: a plan is being measured")
    node.runs.goal = None
    assert node.value("settle_time") == 2.5


def test_a_sequencer_is_deactivated_and_activated(spinning: Any, tmp_path: Path) -> None:
    usual = {"cell": str(CELL), "motion.backend": "external", "force_torque": "", "recorder": "", "progress": False}
    given = [Parameter(name, value=value) for name, value in usual.items()]
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=given))
    entities = len(node._entities())
    for _ in range(2):
        assert node.change(DEACTIVATE), node.trouble
        assert len(node._entities()) < entities
        assert node.change(ACTIVATE), node.trouble
        assert len(node._entities()) == entities
    assert node.busy() == ""
    assert not (tmp_path / "session").exists()
