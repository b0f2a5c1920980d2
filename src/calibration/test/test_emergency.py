"""The guard's own stop: motions that are not permitted, or that nobody watches, are cancelled, and it is told once."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from action_msgs.srv import CancelGoal

from calibration.guard.emergency import MOVES, UNHEARD, WATCHED, Emergency
from calibration.motion.stop_path import CancelGoals
from calibration.node import CalibrationNode
from calibration.topics import MOTION_PULSE

AGE = 0.5  # s


class Watch:
    """An emergency stop, the driver it cancels, and the sequencer's sign of life."""

    def __init__(self, spinning: Any, trace: Path) -> None:
        self.node = spinning.add(CalibrationNode("guard", (), context=spinning.context))
        self.cancelled = 0
        self.node.create_service(CancelGoal, "move/_action/cancel_goal", self._on_cancel)
        self.emergency = Emergency(self.node, CancelGoals(self.node, "move", lambda *_: None), AGE, str(trace))
        self.emergency.listen()
        self.pulse = spinning.plain().create_publisher(MOTION_PULSE.message, MOTION_PULSE.relative, MOTION_PULSE.qos)

    def _on_cancel(self, _request: Any, response: Any) -> Any:
        self.cancelled += 1
        return response

    def says(self, until: Any, *, moving: bool) -> None:
        """Let the sequencer speak, and the guard hear it."""
        before = self.emergency._heard
        until(self.pulse.get_subscription_count)
        self.pulse.publish(MOTION_PULSE.message(data=moving))
        until(lambda: self.emergency._heard > before)

    def told(self) -> tuple[int, str] | None:
        """Level and text about motions."""
        status = self.node.diagnostics._status.get("motion")
        return None if status is None else (int.from_bytes(status.level, "big"), status.message)


@pytest.fixture
def watch(spinning: Any, tmp_path: Path) -> Watch:
    return Watch(spinning, tmp_path / "trace.csv")


def test_no_motion_needs_no_permission(watch: Watch, until: Any) -> None:
    watch.emergency.look(time.monotonic(), permitted=False)
    watch.says(until, moving=False)
    watch.emergency.look(time.monotonic() + 10.0, permitted=False)
    assert watch.told() is None


def test_a_motion_without_permission(watch: Watch, until: Any, tmp_path: Path) -> None:
    for count in (1, 2):
        watch.says(until, moving=True)
        watch.emergency.look(time.monotonic(), permitted=False)
        watch.emergency.look(time.monotonic(), permitted=False)  # nothing new was heard
        until(lambda count=count: watch.cancelled == count)
        assert watch.told() == (2, "a motion is under way that is not permitted")
    watch.says(until, moving=False)
    watch.emergency.look(time.monotonic(), permitted=True)
    assert watch.told() == (2, "a motion is under way that is not permitted")
    watch.says(until, moving=True)
    watch.emergency.look(time.monotonic(), permitted=True)
    assert watch.told() == (0, WATCHED)
    assert (watch.cancelled, len((tmp_path / "trace.csv").read_text().splitlines())) == (2, 2)


def test_a_motion_that_nobody_watches(watch: Watch, until: Any) -> None:
    watch.says(until, moving=True)
    watch.emergency.look(time.monotonic() + 0.5 * AGE, permitted=True)
    assert watch.told() is None
    watch.emergency.look(time.monotonic() + 2.0 * AGE, permitted=True)
    until(lambda: watch.cancelled == 1)
    assert watch.told() == (2, "the sequencer is silent while its motion is under way")


def test_a_robot_that_moves_without_any_sign_of_life_is_stopped_again_and_again(watch: Watch, until: Any) -> None:
    now = time.monotonic()
    watch.emergency.look(now, permitted=True, speed=0.5 * MOVES)
    watch.emergency.look(now, permitted=True, speed=math.nan)
    assert watch.told() is None
    watch.emergency.look(now, permitted=True, speed=2.0 * MOVES)
    watch.emergency.look(now + 0.1, permitted=True, speed=2.0 * MOVES)
    until(lambda: watch.cancelled == 1)
    watch.emergency.look(now + 1.0, permitted=True, speed=2.0 * MOVES)
    until(lambda: watch.cancelled == 2)
    assert watch.told() == (2, UNHEARD)
    assert not watch.emergency.hears(time.monotonic())
    watch.says(until, moving=False)  # the guard hears it: who moves the robot then is the operator's affair
    watch.emergency.look(time.monotonic(), permitted=True, speed=2.0 * MOVES)
    assert watch.cancelled == 2
    assert watch.emergency.hears(time.monotonic())
    assert not watch.emergency.hears(time.monotonic() + 2.0 * AGE)
