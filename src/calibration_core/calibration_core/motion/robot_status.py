"""The state of a robot and its controller, in words of our own; the numbers are those of `RobotState` messages."""

from __future__ import annotations

import dataclasses
import enum
import math


class OperatingMode(enum.IntEnum):
    """Who moves the robot, and how fast it may be."""

    UNKNOWN = 0
    MANUAL_REDUCED = 1
    MANUAL_HIGH = 2
    AUTOMATIC = 3
    EXTERNAL = 4
    MANUAL_UNSPECIFIED = 5


class Drives(enum.IntEnum):
    """Whether the drives are powered."""

    UNKNOWN = 0
    OFF = 1
    ON = 2


class SafetyState(enum.IntEnum):
    """What the controller's safety functions say."""

    UNKNOWN = 0
    NORMAL = 1
    REDUCED = 2
    ENABLING_STOP = 3
    SAFEGUARD_STOP = 4
    PROTECTIVE_STOP = 5
    EMERGENCY_STOP = 6
    FAULT = 7


class Reason(enum.IntEnum):
    """Why motion is not permitted; the numbers are those of `Permission` messages."""

    NOT_STARTED = 0
    STATE_ABSENT = 1
    STATE_STALE = 2
    MODE_UNKNOWN = 3
    MODE_NOT_ALLOWED = 4
    DRIVES_UNKNOWN = 5
    DRIVES_OFF = 6
    SAFETY_UNKNOWN = 7
    SAFETY_STOP = 8
    MOTION_NOT_POSSIBLE = 9
    IN_ERROR = 10
    JOINTS_ABSENT = 11
    JOINTS_STALE = 12
    JOINTS_FROZEN = 13
    JOINTS_NOT_FINITE = 14
    JOINTS_JUMPED = 15
    OVER_SPEED = 16
    PLANNED_OVER_SPEED = 17
    CLOCK_JUMPED = 18
    CONFIRMATION_EXPIRED = 19
    SPEED_LIMIT_MISSING = 20
    SPEED_SCALING_ZERO = 21
    LATCHED = 22
    STOPPING = 23
    SPEED_UNKNOWN = 24
    STOP_UNPROVEN = 25
    SEQUENCER_SILENT = 26
    TWO_GUARDS = 27
    TWO_SOURCES = 28


TEXT = {
    Reason.NOT_STARTED: "nothing has been judged yet",
    Reason.STATE_ABSENT: "no robot state has arrived",
    Reason.STATE_STALE: "the robot state is out of date",
    Reason.MODE_UNKNOWN: "the operating mode is not known",
    Reason.MODE_NOT_ALLOWED: "the operating mode is not one in which motion is allowed",
    Reason.DRIVES_UNKNOWN: "it is not known whether the drives are on",
    Reason.DRIVES_OFF: "the drives are off",
    Reason.SAFETY_UNKNOWN: "the safety state is not known",
    Reason.SAFETY_STOP: "a safety function has stopped the robot",
    Reason.MOTION_NOT_POSSIBLE: "the controller says that motion is not possible",
    Reason.IN_ERROR: "the controller is in error",
    Reason.JOINTS_ABSENT: "no joint states have arrived",
    Reason.JOINTS_STALE: "the joint states are out of date",
    Reason.JOINTS_FROZEN: "the joint states repeat although the robot is in motion",
    Reason.JOINTS_NOT_FINITE: "a joint state is not a finite number",
    Reason.JOINTS_JUMPED: "the joint states jumped",
    Reason.OVER_SPEED: "a monitored point is too fast",
    Reason.PLANNED_OVER_SPEED: "the planned motion is too fast",
    Reason.CLOCK_JUMPED: "the clock jumped",
    Reason.CONFIRMATION_EXPIRED: "the operator's confirmation of the mode has ended",
    Reason.SPEED_LIMIT_MISSING: "no safety-rated speed limit is known for this mode",
    Reason.SPEED_SCALING_ZERO: "the controller has paused the motion",
    Reason.LATCHED: "an earlier fault waits for the operator's reset",
    Reason.STOPPING: "the guard is being shut down",
    Reason.SPEED_UNKNOWN: "the speed is not known yet: it takes two joint states in a row",
    Reason.STOP_UNPROVEN: "it has not been seen yet that the guard can stop the robot",
    Reason.SEQUENCER_SILENT: "the sequencer fell silent while its motion was under way",
    Reason.TWO_GUARDS: "there are two guards",
    Reason.TWO_SOURCES: "the same is published by two",
}


@dataclasses.dataclass(frozen=True)
class RobotStatus:
    """One state of the robot.  States are compared: what is unknown is None.

    Attributes:
        operating_mode: Mode.
        drives: Whether they are powered.
        safety: Safety state.
        motion_possible: None where the source does not say; `in_motion` and `in_error` likewise.
        in_motion: Whether it moves.
        in_error: Whether the controller reports an error.
        speed_scaling: Share of the programmed speed, 0 ... 1; a number that is not finite is unknown, here and below.
        speed_limit: m/s, Cartesian limit that the controller monitors.
        operator_confirmed: The mode was confirmed by a person and is not reported by the controller.
        confirmed_until: s, end of that confirmation, by the guard's clock.
    """

    operating_mode: OperatingMode = OperatingMode.UNKNOWN
    drives: Drives = Drives.UNKNOWN
    safety: SafetyState = SafetyState.UNKNOWN
    motion_possible: bool | None = None
    in_motion: bool | None = None
    in_error: bool | None = None
    speed_scaling: float | None = None
    speed_limit: float | None = None
    operator_confirmed: bool = False
    confirmed_until: float | None = None

    def __post_init__(self) -> None:
        for name in ("speed_scaling", "speed_limit", "confirmed_until"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                object.__setattr__(self, name, None)
