"""Faults of the living cell on command: which are on, since when, and what they do to what is sent."""

from __future__ import annotations

import dataclasses
import enum


class Kind(enum.Enum):
    """What can go wrong."""

    NONE = "ends all faults"
    MODE_FLIP = "automatic mode"
    OVER_SPEED = "moves faster than commanded; value: factor"
    SERVO_OFF = "drives off"
    MODE_STALE = "robot state stops"
    JOINTS_STALE = "joint states stop"
    JOINTS_FROZEN = "joint states repeat the last values"
    JOINTS_NOT_FINITE = "joint states are NaN"
    DRIVER_KILLED = "the process ends without a word"
    CLOCK_JUMP = "/clock leaps; value: s"
    EMERGENCY_STOP = "emergency stop"
    BEAM_BROKEN = "the tracker repeats the last place; of one point"
    TRACKER_JUMP = "value: m; of one point"
    TRACKER_NOT_FINITE = "NaN; of one point"
    TRACKER_SILENT = "nothing is sent; of one point"
    WRENCH_NOT_FINITE = "NaN"
    WRENCH_SILENT = "nothing is sent"
    WRENCH_OFFSET = "value: N on every force component"
    LOAD_STUCK = "the load device does not answer"
    BLOCKED = "moves do not arrive"
    TARGETS_EXCHANGED = "the tracker takes the first two points for each other"
    TRACKER_DRIFT = "value: m/s, along every axis"
    TRACKER_HELD = "the places of when it began, with fresh noise"


@dataclasses.dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        kind: Which.
        value: As the kind says.
        since: s of the cell's time, when it began.
        point: Which measurement point; empty: all.
    """

    kind: Kind
    value: float = 0.0
    since: float = 0.0
    point: str = ""

    @classmethod
    def read(cls, text: str, since: float) -> Fault:
        """Return the fault that `KIND [VALUE [POINT]]` names.

        Raises:
            ValueError: There is no such kind, or the value is no number.
        """
        name, value, point = (*text.split(), *("", "0", "")[len(text.split()) :])
        if name not in Kind.__members__:
            raise ValueError(f"found {name!r}, expected one of {', '.join(Kind.__members__)}")
        return cls(Kind[name], float(value), since, point)


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
