"""The guard's own stop: what is to be stopped is cancelled, noted and told."""

from __future__ import annotations

import itertools
import math
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from action_msgs.srv import CancelGoal
from calibration_interfaces.msg import MotionPulse

from calibration.guard.emergency import STANDS, WATCHED, Emergency
from calibration.motion.stop import CancelGoals
from calibration.node import CalibrationNode
from calibration.topics import MOTION_PULSE
from calibration_core.motion.motion_watch import FORBIDDEN, MOVES

AGE = 0.5  # s


class Watch:
    """An emergency stop, the driver it cancels, and the sequencer's sign of life."""

    def __init__(self, spinning: Any, trace: Path) -> None:
        self.node = spinning.add(CalibrationNode("guard", (), context=spinning.context))
        self.cancelled = 0
        self.node.create_service(CancelGoal, "move/_action/cancel_goal", self._on_cancel)
        self.emergency = Emergency(self.node, CancelGoals(self.node, "move", lambda *_: None), AGE, str(trace))
        self.pulse = spinning.plain().create_publisher(MotionPulse, MOTION_PULSE.relative, MOTION_PULSE.qos)
        self.counted = itertools.count()

    def _on_cancel(self, _request: Any, response: Any) -> Any:
        self.cancelled += 1
        return response

    def says(self, until: Any, *, moving: bool) -> None:
        """Let the sequencer speak, and the guard hear it."""
        before = self.emergency._watch._heard
        until(self.pulse.get_subscription_count)
        self.pulse.publish(MotionPulse(identity=1, count=next(self.counted), moving=moving))
        until(lambda: self.emergency.take() or self.emergency._watch._heard > before)

    def told(self) -> tuple[int, str] | None:
        """Level and text about motions."""
        status = self.node.diagnostics._status.get("motion")
        return None if status is None else (int.from_bytes(status.level, "big"), status.message)


@pytest.fixture
def watch(spinning: Any, tmp_path: Path) -> Watch:
    return Watch(spinning, tmp_path / "trace.csv")


def test_every_stop_is_commanded_noted_and_told_once(watch: Watch, until: Any, tmp_path: Path) -> None:
    """Which motion is stopped is a rule of the core, with tests of its own."""
    watch.says(until, moving=False)
    watch.emergency.look(time.monotonic(), permitted=False)
    assert watch.told() is None
    for count in (1, 2):
        watch.says(until, moving=True)
        watch.emergency.look(time.monotonic(), permitted=False)
        watch.emergency.look(time.monotonic(), permitted=False)  # nothing new was heard
        until(lambda count=count: watch.cancelled == count)
        assert watch.told() == (2, FORBIDDEN)
    watch.says(until, moving=False)
    for speed in (math.nan, 2.0 * MOVES):
        watch.emergency.look(time.monotonic(), permitted=True, speed=speed)
        assert watch.told() == (2, FORBIDDEN)
    watch.emergency.look(time.monotonic(), permitted=False, speed=0.0)
    assert watch.told() == (0, STANDS)
    watch.says(until, moving=True)
    watch.emergency.look(time.monotonic(), permitted=False, speed=2.0 * MOVES)
    until(lambda: watch.cancelled == 3)
    watch.says(until, moving=True)
    watch.emergency.look(time.monotonic(), permitted=True)
    assert watch.told() == (0, WATCHED)
    assert (watch.cancelled, len((tmp_path / "trace.csv").read_text().splitlines())) == (3, 3)
