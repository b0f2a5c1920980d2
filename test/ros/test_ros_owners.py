"""Who may stop and move the robot: one guard, one sequencer, and only after the stop was seen; shipped trees."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from live_tree import LONG, SIMULATED, BackEnd, LiveTree, long_ways
from middleman import ACTION, TOPIC, Middleman

from calibration.process_tree import REAL_CELL

THROUGH_ACTION = BackEnd(
    "simulated", REAL_CELL, (("adapter", "native"), ("backend", "simulated"), ("interface", ACTION))
)
THROUGH_TOPIC = BackEnd(
    "joint_trajectory_topic", REAL_CELL,
    (("adapter", "native"), ("backend", "joint_trajectory_topic"), ("interface", TOPIC)),
)  # fmt: skip


@pytest.fixture(scope="module")
def far_plan(plan: Path) -> Path:
    return long_ways(plan)


def second(suite: Any, name: str) -> subprocess.CompletedProcess[str]:
    """Start another process of a node, as the first one was."""
    return subprocess.run(
        suite.given[name], env=suite.environment, capture_output=True, text=True, timeout=60, check=False
    )


def test_a_second_one_is_refused_and_a_guard_that_is_told_to_end_stops_the_robot_first(
    suite: Any, far_plan: Path
) -> None:
    tree = LiveTree(suite, far_plan, SIMULATED)
    codes: dict[str, int] = {}
    tree.move()
    for name in ("guard", "sequencer", "recorder", "tracker", "force_torque"):
        answer = second(suite, name)
        first = suite.processes[name].pid
        codes[name] = answer.returncode  # 1: on a busy machine it hears the first one when it has begun, and ends
        assert codes[name] in (1, 2), (name, answer.stderr)
        lines = [one for one in answer.stderr.splitlines() if "another one is process" in one]
        assert f"two {name}s: another one is process {first} on " in lines[0], answer.stderr
        assert codes[name] == 1 or answer.stderr.splitlines() == lines[:1]
    if codes["guard"] == 2:  # whoever was there first is not disturbed
        assert "two guards" not in tree.state.permission.text
    tree.move()
    asked = time.monotonic_ns()
    code, _ = suite.end("guard")
    assert code == 0
    stopped, rest = tree.events(asked, "cancel"), tree.events(asked, "rest")
    assert stopped
    assert rest  # when the guard has ended, the robot stands
    tree.stands()
    tree.see_quiet("after the guard was told to end")
    suite.again("guard")
    tree.await_active("guard", suite.processes["guard"].pid)
    tree.see_quiet("after the guard was started again")
    tree.allow()
    tree.move()
    assert tree.moved == []


def test_of_two_guards_that_start_at_once_one_ends(suite: Any) -> None:
    """Neither hears the other before it begins: the younger one ends, the elder one latches."""
    suite.start("guard", motion__backend="simulated")
    first = suite.processes.pop("guard")
    suite.again("guard")
    other = suite.processes["guard"]
    end = time.monotonic() + 60.0
    while first.poll() is None and other.poll() is None:
        assert time.monotonic() < end, suite.log("guard")
        time.sleep(0.05)
    time.sleep(2.0)
    ended, left = (first, other) if first.poll() is not None else (other, first)
    assert ended.poll() in (1, 2)
    assert left.poll() is None
    assert "two guards: another one is process" in suite.log("guard")
    suite.processes["guard"] = left


@pytest.mark.parametrize("back_end", [THROUGH_ACTION, THROUGH_TOPIC], ids=["action", "topic"])
def test_nothing_moves_before_the_stop_was_seen(suite: Any, spinning: Any, far_plan: Path, back_end: BackEnd) -> None:
    """A driver that cancels too late, a robot that creeps; once both are put right, the plan is measured."""
    middle = Middleman(spinning.plain("middleman"))
    by_action = back_end is THROUGH_ACTION
    middle.deaf, middle.creeps = (1.5, False) if by_action else (0.0, True)
    tree = LiveTree(suite, far_plan, back_end)
    faults = ["the goal was not cancelled within 0.5 s"] if by_action else []
    for fault in [*faults, "mrad while the robot was to stand"]:
        await_question(tree, fault)
        assert tree.state.procedure.question.startswith("the stop cannot be proven: ")
        assert tree.state.procedure.paused
        middle.deaf, middle.creeps = 0.0, by_action and not middle.creeps
        time.sleep(1.0)  # the stand-in has let go of the robot
        tree.see_quiet("without a proof")
        tree.allow()
    tree.move()
    assert tree.moved == []
    stop = tree.state.permission.stop
    assert stop == (f"every goal of {ACTION} is cancelled" if by_action else f"the position is held by {TOPIC}")


def await_question(tree: LiveTree, words: str) -> None:
    """Wait until the operator is asked something; whatever else a busy machine has him asked, he has it tried again."""
    end = time.monotonic() + 2.0 * LONG
    while words not in tree.state.procedure.question:
        assert time.monotonic() < end, f"{tree.state.procedure.question}\n{tree.words()}"
        time.sleep(0.2)
        if tree.state.procedure.paused and words not in tree.state.procedure.question:
            tree.allow()
