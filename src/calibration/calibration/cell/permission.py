"""What the guard says, as those who move hear it: silence means no."""

from __future__ import annotations

import math
import threading
from typing import Any

from calibration_interfaces.msg import Permission

SILENT = "the guard is silent"
UNHEARD = 5.0  # times the age that permits motion: drives may have gone off and on again without a word of it
# What a reading needs of the robot from its unloaded step on: with its brakes on it is another robot.
ROBOT = frozenset({
    Permission.NOT_STARTED, Permission.STATE_ABSENT, Permission.STATE_STALE, Permission.MODE_UNKNOWN,
    Permission.MODE_NOT_ALLOWED, Permission.DRIVES_UNKNOWN, Permission.DRIVES_OFF, Permission.SAFETY_UNKNOWN,
    Permission.SAFETY_STOP, Permission.IN_ERROR, Permission.CONFIRMATION_EXPIRED,
})  # fmt: skip


class PermissionWatch:
    """The guard's last word and how old it is; times are s of the steady clock."""

    def __init__(self, max_age: float) -> None:
        """Take how old a word may be, s."""
        self._max_age = max_age
        self._lock = threading.Lock()
        self._permitted, self._text, self._heard = False, SILENT, -math.inf
        self._hears = self._latched = False
        self._reasons: frozenset[int] = frozenset()
        self._against = -math.inf
        self._unsound = (-math.inf, "")
        self._state = -math.inf

    def hear(self, message: Any, now: float) -> None:
        """Take a `Permission` that arrived at `now`."""
        with self._lock:
            if now - self._heard > UNHEARD * self._max_age:
                self._unsound = (now, SILENT)
            self._permitted, self._text, self._heard = bool(message.permitted), str(message.text), now
            self._hears, self._latched = bool(message.hears_sequencer), bool(message.latched)
            self._reasons = frozenset(int(reason) for reason in message.reasons)
            if not self._waits_for_proof:
                self._against = now
            if self._reasons & ROBOT:
                self._unsound = (now, self._text)

    def state(self, now: float) -> None:
        """Take notice of a state of the robot, which the guard judges, too."""
        with self._lock:
            self._state = now

    def judged(self, moment: float) -> bool:
        """Tell whether the guard has spoken on a state of the robot that came after a moment."""
        with self._lock:
            return self._heard > max(self._state, moment) and (self._state > moment or self._state == -math.inf)

    def unsound(self, since: float, now: float) -> str:
        """Say what was wrong since then with mode, drives or safety, or that it is not known; empty if nothing was."""
        with self._lock:
            if now - self._heard > UNHEARD * self._max_age:
                return SILENT
            return self._unsound[1] if self._unsound[0] >= since else ""

    @property
    def _waits_for_proof(self) -> bool:
        """Whether at most the proof is missing; while it is tried, a robot that stands counts as one that moves."""
        proof = {Permission.STOP_UNPROVEN, Permission.JOINTS_FROZEN}
        return self._reasons <= (proof if Permission.STOP_UNPROVEN in self._reasons else set())

    def at(self, now: float) -> tuple[bool, str]:
        """Return whether motion is permitted at `now`, and the guard's words."""
        with self._lock:
            if now - self._heard > self._max_age:
                return False, SILENT
            return self._permitted, self._text

    def hears(self, now: float) -> bool:
        """Tell whether the guard, as of `now`, hears the sequencer's sign of life."""
        with self._lock:
            return self._hears and now - self._heard <= self._max_age

    def ready(self, now: float) -> bool:
        """Tell whether nothing speaks against motion at `now`, but for a proof of the stop that may be missing."""
        with self._lock:
            return now - self._heard <= self._max_age and self._waits_for_proof

    @property
    def against(self) -> float:
        """When something besides a missing proof last spoke against motion, s of the steady clock."""
        with self._lock:
            return self._against

    @property
    def latched(self) -> bool:
        """Whether the guard's last word was that a fault is latched."""
        with self._lock:
            return self._latched

    @property
    def unproven(self) -> bool:
        """Whether the guard's last word was that it is not known to be able to stop the robot."""
        with self._lock:
            return Permission.STOP_UNPROVEN in self._reasons
