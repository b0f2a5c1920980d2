"""What the sequencer hears of guard, sensor and driver.

What the guard says is heard as by everybody who moves: silence means no.  What pulls now the sensor's node tells as a
mean, not as samples.  A robot that its driver describes as another one than the cell file's is not moved; comparing
takes some tenths of a second, in a thread of its own: the sequencer's sign of life goes on meanwhile.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import numpy as np
from calibration_interfaces.msg import Permission

from calibration.conversions import wrench_values
from calibration.rclpy_gaps import Waiting
from calibration.topics import PRESENT_WRENCH, TARE, Quality, message_class, profile
from calibration_core.errors import CellError
from calibration_core.planning.plans.described_robot import description_fault
from calibration_core.recording.definitions.own import TEXT_TYPE
from calibration_core.timeseries import Float1D

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


FRESH = 1.0  # s of wall time; an older last mean says nothing about now


class WrenchWatch:
    """Hears the present wrench and the tares.

    Attributes:
        topic: Where the wrench comes from.
        tares: How many tares have been reported.
        tare: Number of the last one.
    """

    def __init__(self, node: Any) -> None:
        """Listen."""
        self.topic = node.cell.topics.wrench
        self._waiting = Waiting(node, PRESENT_WRENCH.message, PRESENT_WRENCH.relative, PRESENT_WRENCH.qos)
        self._heard, self._mean = -np.inf, np.zeros(6)  # s of the steady clock
        self._biases: dict[int, Float1D] = {}  # by the number of the tare
        self.tares = self.tare = 0
        node.create_subscription(TARE.message, TARE.relative, self._on_tare, TARE.qos)

    def take(self) -> None:
        """Take what has come; to be called some times in `FRESH`."""
        for message in self._waiting.take():
            self._mean, self._heard = wrench_values(message.wrench), time.monotonic()

    def _on_tare(self, message: Any) -> None:
        self.tares, self.tare = self.tares + 1, int(message.number)
        self._biases[self.tare] = wrench_values(message.bias)

    def bias(self, tare: int) -> Float1D:
        """Return what a tare subtracts, (6,) N and N*m."""
        return self._biases.get(tare, np.zeros(6))

    @property
    def now(self) -> Float1D | None:
        """The mean (6,) N and N*m of the last half second; None where the sensor is silent."""
        return None if time.monotonic() - self._heard > FRESH else self._mean


PATIENCE = 10.0  # s of wall time, that a comparison may take


class DescriptionWatch:
    """Listens to the robot description.

    Attributes:
        fault: Why it is not the cell's robot; empty: it is, or nothing is known yet.
    """

    def __init__(self, node: Any) -> None:
        """Listen; who comes late gets the last description.  `node` is the sequencer, with its cell."""
        self._node, self.topic = node, node.cell.topics.robot_description
        self.fault = ""
        self._text: str | None = None
        self._thread: threading.Thread | None = None
        kind, quality = message_class(TEXT_TYPE), profile(Quality.STATE)
        node.create_subscription(kind, self.topic.lstrip("/"), self._on_description, quality)

    def _on_description(self, message: Any) -> None:
        if message.data == self._text:
            return
        self._text = str(message.data)
        self._thread = threading.Thread(target=self._compare, args=(self._text,), daemon=True)
        self._thread.start()

    def _compare(self, text: str) -> None:
        try:
            different = description_fault(text, self._node.cell)
        except CellError as error:
            different = str(error)
        if text == self._text:  # no other one has come meanwhile
            self.fault = f"{self.topic} is another robot than {self._node.cell.path}: {different}" if different else ""

    def judged(self) -> str:
        """Wait until what came is compared, and return the fault; where nothing came, say that, and find no fault."""
        thread, name = self._thread, "robot description"
        if thread is not None:
            thread.join(PATIENCE)
        if self._text is None:
            text = f"nothing comes on {self.topic}: nobody has held the robot against {self._node.cell.path}"
            self._node.get_logger().warning(text)
            self._node.diagnostics.report(name, 1, text)
        else:
            self._node.diagnostics.report(name, 2 if self.fault else 0, self.fault or "as the cell file says")
        return self.fault
