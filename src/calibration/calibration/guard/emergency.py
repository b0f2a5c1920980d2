"""The guard's own hand on the motion: it stops the robot by the back end's stop path when nobody else may be able to.

The sequencer stops its motions itself.  This is for the case that it cannot any more: it was killed, hangs, or does not
hear.  Its sign of life tells whether a motion of its own is under way.  A robot that moves without any such sign is
stopped, too: a guard that was started again may not hear the sequencer, and would not know when it falls silent.
"""

from __future__ import annotations

import math
from pathlib import Path

from calibration_interfaces.msg import MotionPulse
from rclpy.qos import QoSProfile

from calibration.motion.stop import StopPath
from calibration.node import CalibrationNode
from calibration.rclpy_gaps import Waiting
from calibration.topics import MOTION_PULSE, publishers
from calibration_core.motion.motion_watch import MOVES, MotionWatch
from calibration_core.motion.stop_proof import RequestedStop

WATCHED = "the motion under way is permitted and watched"
STANDS = "no motion is under way"
DEAF = "the driver does not acknowledge that it stops: press the emergency stop"


class Emergency:
    """Stops what nobody watches; times are s of the steady clock."""

    def __init__(self, node: CalibrationNode, stop: StopPath, max_age: float, trace: str) -> None:
        """Listen to the sequencer's sign of life.

        Args:
            node: The guard.
            stop: How the robot is stopped.
            max_age: s, of the sign of life.
            trace: File for the monotonic clock's ns of every stop; empty: none.
        """
        self._node, self._stop = node, stop
        self._trace = Path(trace) if trace else None
        self._reported = ""
        self._watch = MotionWatch(max_age, can_stop=stop.how is not RequestedStop.NONE)
        every = QoSProfile(depth=100)  # a stranger's signs of life do not push out those of the sequencer
        self._pulses = Waiting(node, MotionPulse, MOTION_PULSE.relative, every)

    def take(self) -> None:
        """Take the signs of life that have come."""
        for message, arrived, _ in self._pulses.arrivals():
            self._watch.on_pulse(message.identity, message.count, arrived, moving=message.moving)

    def hears(self, now: float) -> bool:
        """Tell whether the sequencer gives a sign of life at `now`, s of the steady clock."""
        return self._watch.hears(now)

    @property
    def moving(self) -> bool:
        """Whether the sequencer said last that a motion of its own is under way."""
        return self._watch.moving

    def another(self, now: float) -> bool:
        """Tell whether another sequencer gives a sign of life beside the one that is followed."""
        return self._watch.another(now)

    def others(self, now: float) -> str:
        """Return who publishes the sign of life, where more than one sequencer does; empty otherwise.

        One that was killed and has been started again stands in the graph twice, by one name.
        """
        names = publishers(self._node, MOTION_PULSE.relative)
        if len(set(names)) < 2 and not self._watch.another(now):
            return ""
        topic = self._node.resolve_topic_name(MOTION_PULSE.relative)
        return f"{topic} is published by {', '.join(names)}"

    def look(self, now: float, *, permitted: bool, speed: float = math.nan) -> str:
        """Stop, and say so, if a motion is under way that is not permitted, or that nobody watches; return why.

        Args:
            now: s of the steady clock.
            permitted: Whether motion is.
            speed: m/s, of the fastest point as measured; NaN: unknown.
        """
        fault = self._watch.fault(now, permitted=permitted, speed=speed)
        if fault:
            self.command(now, fault)
        if self._stop.unanswered(now):
            fault = fault or DEAF
        # What was reported stands until the robot does, or a motion is as it should be.
        if fault != self._reported and (fault or self.moving or speed <= MOVES):
            self._reported = fault
            self._node.diagnostics.report("motion", 2 if fault else 0, fault or (WATCHED if self.moving else STANDS))
            if fault:
                self._node.get_logger().error(fault)
        return fault

    def command(self, now: float, why: str) -> None:
        """Stop whatever moves, and note why."""
        self._stop.command(now)
        if self._trace is not None and self._stop.how is not RequestedStop.NONE:
            with self._trace.open("a", encoding="utf-8") as file:
                file.write(f"{round(now * 1e9)},stop: {why}\n")
