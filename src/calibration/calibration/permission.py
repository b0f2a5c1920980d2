"""What the guard says, as those who move hear it: silence means no."""

from __future__ import annotations

import math
import threading
from typing import Any

SILENT = "the guard is silent"


class PermissionWatch:
    """The guard's last word and how old it is; times are s of the steady clock."""

    def __init__(self, max_age: float) -> None:
        """Take how old a word may be, s."""
        self._max_age = max_age
        self._lock = threading.Lock()
        self._permitted, self._text, self._heard = False, SILENT, -math.inf
        self._hears = False

    def hear(self, message: Any, now: float) -> None:
        """Take a `Permission` that arrived at `now`."""
        with self._lock:
            self._permitted, self._text, self._heard = bool(message.permitted), str(message.text), now
            self._hears = bool(message.hears_sequencer)

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
