"""Does the sequencer live, and is a motion under way that has to be stopped?  The rule, without clock or messages.

The sequencer's sign of life says who it is, counts, and tells whether a motion of its own is under way.  The guard
follows one sequencer.  Another one's sign of life is never taken for that of the one that is followed: it is an error
while that one lives, and is followed only when that one has been silent and the robot stands.
"""

from __future__ import annotations

import math

MOVES = 0.02  # m/s of the fastest point: a robot at rest is never as fast, noise included
AGAIN = 0.5  # s between stops of a motion that nobody watches
REPORTED = 1.0  # s, that another sequencer counts since its last sign of life
SILENT = "the sequencer is silent while its motion is under way"
UNHEARD = "the robot moves and no sign of life of the sequencer is heard"
FORBIDDEN = "a motion is under way that is not permitted"


class MotionWatch:
    """Follows one sequencer.  All times are s on one clock.

    Args:
        max_age: s, of the sign of life.
        can_stop: Whether the guard has means to stop the robot: one that a hand on the pendant moves is left alone.

    Attributes:
        moving: Whether the sequencer said last that a motion of its own is under way.
    """

    def __init__(self, max_age: float, *, can_stop: bool) -> None:
        self._max_age, self._can_stop = max_age, can_stop
        self.moving = False
        self._identity, self._count = 0, -1
        self._heard = self._stranger = self._commanded = -math.inf
        self._speed = math.nan

    def on_pulse(self, identity: int, count: int, now: float, *, moving: bool) -> None:
        """Take a sign of life that arrived at `now`.

        Args:
            identity: Of the sequencer's process.
            count: Of its signs of life; one that does not count on is a copy of what was said before.
            now: s.
            moving: Whether a motion of its own is under way.
        """
        if identity != self._identity:
            first = self._heard == -math.inf
            if self.hears(now):
                self._stranger = now
            if not first and (self.hears(now) or self.moving or not self._speed <= MOVES):
                return
            self._identity, self._count = identity, -1
        if count > self._count:
            self._count, self._heard, self.moving = count, now, moving

    def hears(self, now: float) -> bool:
        """Tell whether the sequencer that is followed gives a sign of life."""
        return now - self._heard <= self._max_age

    def another(self, now: float) -> bool:
        """Tell whether another one gives a sign of life beside it, or did so a moment ago."""
        return now - self._stranger <= REPORTED

    def fault(self, now: float, *, permitted: bool, speed: float) -> str:
        """Return why a motion that is under way has to be stopped now; empty if none has to be.

        Args:
            now: s.
            permitted: Whether motion is.
            speed: m/s, of the fastest point as measured; NaN: unknown.
        """
        self._speed = speed
        if self.moving:
            found = "" if permitted else FORBIDDEN
            found = found if self.hears(now) else SILENT
        else:
            orphan = self._can_stop and speed > MOVES and not self.hears(now) and now - self._commanded > AGAIN
            found = UNHEARD if orphan else ""
        if found:
            self.moving, self._commanded = False, now  # until the sequencer says so again
        return found
