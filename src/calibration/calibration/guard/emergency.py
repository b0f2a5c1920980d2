"""The guard's own hand on the motion: it stops the robot by the back end's stop path when nobody else may be able to.

The sequencer stops its motions itself.  This is for the case that it cannot any more: it was killed, hangs, or does not
hear.  Its sign of life tells whether a motion of its own is under way.  A robot that moves without any such sign is
stopped, too: a guard that was started again may not hear the sequencer, and would not know when it falls silent.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

from calibration.motion.stop_path import StopPath
from calibration.node import CalibrationNode
from calibration.topics import MOTION_PULSE
from calibration_core.motion.stop_proof import RequestedStop

UNHEARD = "the robot moves and no sign of life of the sequencer is heard"
MOVES = 0.02  # m/s of the fastest point: a robot at rest is never as fast, noise included
AGAIN = 0.5  # s between stops of such a motion
WATCHED = "the motion under way is permitted and watched"
SILENT = "the sequencer is silent while its motion is under way"
DEAF = "the driver does not acknowledge that it stops: press the emergency stop"


class Emergency:
    """Stops what nobody watches; times are s of the steady clock."""

    def __init__(self, node: CalibrationNode, stop: StopPath, max_age: float, trace: str) -> None:
        """Prepare.

        Args:
            node: The guard.
            stop: How the robot is stopped.
            max_age: s, of the sign of life.
            trace: File for the monotonic clock's ns of every stop; empty: none.
        """
        self._node, self._stop, self._max_age = node, stop, max_age
        self._trace = Path(trace) if trace else None
        self._moving, self._heard, self._reported = False, -math.inf, ""
        self._unheard = -math.inf

    def listen(self) -> None:
        """Listen to the sequencer's sign of life."""
        self._moving, self._heard = False, -math.inf
        self._node.create_subscription(MOTION_PULSE.message, MOTION_PULSE.relative, self._on_pulse, MOTION_PULSE.qos)

    def _on_pulse(self, message: Any) -> None:
        self._moving = bool(message.data)
        self._heard = time.monotonic()

    def hears(self, now: float) -> bool:
        """Tell whether the sequencer gives a sign of life at `now`, s of the steady clock."""
        return now - self._heard <= self._max_age

    @property
    def moving(self) -> bool:
        """Whether the sequencer said last that a motion of its own is under way."""
        return self._moving

    def look(self, now: float, *, permitted: bool, speed: float = math.nan) -> str:
        """Stop, and say so, if a motion is under way that is not permitted, or that nobody watches; return why.

        Args:
            now: s of the steady clock.
            permitted: Whether motion is.
            speed: m/s, of the fastest point as measured; NaN: unknown.
        """
        fault = self._fault(now, permitted=permitted, speed=speed)
        if fault:
            self._moving = False  # until the sequencer says so again
            self.command(now, fault)
        if self._stop.unanswered(now):
            fault = fault or DEAF
        # What was reported stands until a motion is as it should be.
        if fault != self._reported and (fault or self._moving):
            self._reported = fault
            self._node.diagnostics.report("motion", 2 if fault else 0, fault or WATCHED)
            if fault:
                self._node.get_logger().error(fault)
        return fault

    def _fault(self, now: float, *, permitted: bool, speed: float) -> str:
        if not self._moving:
            silent = not self.hears(now) and now - self._unheard > AGAIN
            if self._stop.how is RequestedStop.NONE or not silent or not speed > MOVES:
                return ""
            self._unheard = now
            return UNHEARD
        if not self.hears(now):
            return SILENT
        return "" if permitted else "a motion is under way that is not permitted"

    def command(self, now: float, why: str) -> None:
        """Stop whatever moves, and note why."""
        self._stop.command(now)
        if self._trace is not None and self._stop.how is not RequestedStop.NONE:
            with self._trace.open("a", encoding="utf-8") as file:
                file.write(f"{round(now * 1e9)},stop: {why}\n")
