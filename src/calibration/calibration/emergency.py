"""The guard's own hand on the motion: it cancels every goal of the driver's action when nobody else may be able to.

The sequencer stops its motions itself.  This is for the case that it cannot any more: it was killed, hangs, or does not
hear.  Its sign of life tells whether a motion of its own is under way.  A robot that moves without any such sign is
stopped, too: a guard that was started again may not hear the sequencer, and would not know when it falls silent.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

from action_msgs.srv import CancelGoal

from calibration.node import CalibrationNode
from calibration.topics import MOTION_PULSE

UNHEARD = "the robot moves and no sign of life of the sequencer is heard"
MOVES = 0.02  # m/s of the fastest point: a robot at rest is never as fast, noise included
AGAIN = 0.5  # s between cancellations of such a motion
WATCHED = "the motion under way is permitted and watched"


class Emergency:
    """Cancels all goals of one action; times are s of the steady clock."""

    def __init__(self, node: CalibrationNode, action: str, max_age: float, trace: str) -> None:
        """Listen to the sequencer's sign of life.

        Args:
            node: The guard.
            action: Name of the driver's action; empty: nothing is ever cancelled.
            max_age: s, of the sign of life.
            trace: File for the monotonic clock's ns of every cancellation; empty: none.
        """
        self._node, self._max_age = node, max_age
        self._client = node.create_client(CancelGoal, f"{action}/_action/cancel_goal") if action else None
        self._trace = Path(trace) if trace else None
        self._moving, self._heard, self._told = False, -math.inf, ""
        self._unheard = -math.inf
        node.create_subscription(MOTION_PULSE.message, MOTION_PULSE.relative, self._on_pulse, MOTION_PULSE.qos)

    def _on_pulse(self, message: Any) -> None:
        self._moving = bool(message.data)
        self._heard = time.monotonic()

    def hears(self, now: float) -> bool:
        """Tell whether the sequencer gives a sign of life at `now`, s of the steady clock."""
        return now - self._heard <= self._max_age

    def look(self, now: float, *, permitted: bool, speed: float = math.nan) -> None:
        """Cancel, and say so, if a motion is under way that is not permitted, or that nobody watches.

        Args:
            now: s of the steady clock.
            permitted: Whether motion is.
            speed: m/s, of the fastest point as measured; NaN: unknown.
        """
        fault = self._fault(now, permitted=permitted, speed=speed)
        if fault:
            self._moving = False  # until the sequencer says so again
            self._cancel(now, fault)
        if fault != self._told and (fault or self._moving):  # what was told stands until a motion is as it should be
            self._told = fault
            self._node.diagnostics.report("motion", 2 if fault else 0, fault or WATCHED)
            if fault:
                self._node.get_logger().error(fault)

    def _fault(self, now: float, *, permitted: bool, speed: float) -> str:
        if not self._moving:
            silent = not self.hears(now) and now - self._unheard > AGAIN
            if self._client is None or not silent or not speed > MOVES:
                return ""
            self._unheard = now
            return UNHEARD
        if not self.hears(now):
            return "the sequencer is silent while its motion is under way"
        return "" if permitted else "a motion is under way that is not permitted"

    def _cancel(self, now: float, why: str) -> None:
        if self._client is None:
            return
        self._client.call_async(CancelGoal.Request())  # no goal's name and no time: all goals
        if self._trace is not None:
            with self._trace.open("a", encoding="utf-8") as file:
                file.write(f"{round(now * 1e9)},cancel all: {why}\n")
