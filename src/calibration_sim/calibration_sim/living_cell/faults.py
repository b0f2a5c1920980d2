"""Faults of the living cell on command: which are on, since when, and what they do to what is sent.

Numbers are those of `calibration_interfaces/srv/SetFault`.
"""

from __future__ import annotations

import dataclasses
import enum
import math


class Kind(enum.IntEnum):
    """What can go wrong."""

    NONE = 0
    MODE_FLIP = 1
    OVER_SPEED = 2
    SERVO_OFF = 3
    MODE_STALE = 4
    JOINTS_STALE = 5
    JOINTS_FROZEN = 6
    JOINTS_NOT_FINITE = 7
    DRIVER_KILLED = 8
    CLOCK_JUMP = 9
    EMERGENCY_STOP = 10
    BEAM_BROKEN = 11
    TRACKER_JUMP = 12
    TRACKER_NOT_FINITE = 13
    TRACKER_SILENT = 14
    WRENCH_NOT_FINITE = 15
    WRENCH_SILENT = 16
    WRENCH_OFFSET = 17
    LOAD_STUCK = 18
    BLOCKED = 19
    TARGETS_EXCHANGED = 20
    TRACKER_DRIFT = 21
    TRACKER_HELD = 22


@dataclasses.dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        kind: Which.
        value: Factor, m, m/s, N or s, as `SetFault` says.
        since: s of the cell's time, when it began.
        until: s of the cell's time, when it ends; infinite: when told.
        point: Which measurement point; empty: all.
    """

    kind: Kind
    value: float = 0.0
    since: float = 0.0
    until: float = math.inf
    point: str = ""


class Faults:
    """The faults that are on."""

    def __init__(self) -> None:
        self._on: dict[Kind, Fault] = {}

    def begin(self, fault: Fault) -> None:
        """Begin a fault, in place of one of the same kind; `NONE` ends all."""
        if fault.kind is Kind.NONE:
            self._on.clear()
        else:
            self._on[fault.kind] = fault

    def at(self, time: float) -> None:
        """Forget what has ended by `time` (s)."""
        self._on = {kind: fault for kind, fault in self._on.items() if time < fault.until}

    def on(self, kind: Kind, point: str = "") -> bool:
        """Tell whether a fault is on, and concerns a point."""
        fault = self._on.get(kind)
        return fault is not None and (not fault.point or not point or fault.point == point)

    def value(self, kind: Kind, otherwise: float) -> float:
        """Return the value of a fault that is on."""
        fault = self._on.get(kind)
        return otherwise if fault is None else fault.value

    def grown(self, kind: Kind, time: float) -> float:
        """Return the value of a fault that grows times the s that it has been on; 0 where it is not."""
        fault = self._on.get(kind)
        return 0.0 if fault is None else fault.value * (time - fault.since)
