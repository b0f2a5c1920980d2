"""What the guard says, as those who move hear it: silence means no."""

from __future__ import annotations

import math
import threading
from typing import Any

from calibration_interfaces.msg import Permission

SILENT = "the guard is silent"


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

    def hear(self, message: Any, now: float) -> None:
        """Take a `Permission` that arrived at `now`."""
        with self._lock:
            self._permitted, self._text, self._heard = bool(message.permitted), str(message.text), now
            self._hears, self._latched = bool(message.hears_sequencer), bool(message.latched)
            self._reasons = frozenset(int(reason) for reason in message.reasons)
            if not self._waits_for_proof:
                self._against = now

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
