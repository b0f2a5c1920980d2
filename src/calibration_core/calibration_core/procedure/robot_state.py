"""The state of a robot and its controller in our own words, whatever the maker calls it.

Numbers are those of `calibration_interfaces/msg/RobotState`.
"""

from __future__ import annotations

import dataclasses
import enum
import math


class OperatingMode(enum.IntEnum):
    """Who moves the robot, and how fast it may go."""

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


class Safety(enum.IntEnum):
    """What the controller's safety functions do."""

    UNKNOWN = 0
    NORMAL = 1
    REDUCED = 2
    ENABLING_STOP = 3
    SAFEGUARD_STOP = 4
    PROTECTIVE_STOP = 5
    EMERGENCY_STOP = 6
    FAULT = 7


class Tri(enum.IntEnum):
    """True, false, or not said."""

    UNDECIDED = -1
    FALSE = 0
    TRUE = 1

    @classmethod
    def of(cls, value: bool | None) -> Tri:
        """Return the value of a bool, UNDECIDED for None."""
        return cls.UNDECIDED if value is None else cls(int(value))


@dataclasses.dataclass(frozen=True)
class RobotState:
    """What a controller reports.

    Attributes:
        operating_mode: Who moves the robot.
        drives: Whether the drives are powered.
        safety: What the safety functions do.
        motion_possible: Whether the controller would move.
        in_motion: Whether it says that it moves.
        in_error: Whether it reports an error.
        speed_scaling: Share of the programmed speed, 0 to 1; NaN: unknown.
        speed_limit: m/s, Cartesian limit that the controller monitors; NaN: unknown.
        vendor_codes: Error codes as the controller gives them.
        source: Adapter, and what it listens to.
        source_time: ns, stamp of the driver's message; 0 where it has none.
        received_time: ns, when the oldest of the messages behind this state arrived; 0: something is missing.
        operator: Who confirmed the mode by word; empty if the controller reported it.
        confirmed_until: ns, end of that confirmation; 0 if there is none.
    """

    operating_mode: OperatingMode = OperatingMode.UNKNOWN
    drives: Drives = Drives.UNKNOWN
    safety: Safety = Safety.UNKNOWN
    motion_possible: Tri = Tri.UNDECIDED
    in_motion: Tri = Tri.UNDECIDED
    in_error: Tri = Tri.UNDECIDED
    speed_scaling: float = math.nan
    speed_limit: float = math.nan
    vendor_codes: tuple[int, ...] = ()
    source: str = ""
    source_time: int = 0
    received_time: int = 0
    operator: str = ""
    confirmed_until: int = 0


@dataclasses.dataclass(frozen=True)
class Confirmation:
    """An operator's word for the operating mode, where the controller does not report it.

    Attributes:
        operator: Who answers for it.
        mode: What was stated.
        until: ns, when it ends.
    """

    operator: str
    mode: OperatingMode
    until: int


def confirmed(state: RobotState, confirmation: Confirmation | None, now: int) -> RobotState:
    """Fill in the mode that an operator confirmed.

    An operator's word says which manual mode it is where the controller says no more than "manual", and the mode where
    it says nothing at all.  It never overrules a mode that the controller reports, and ends at its time.
    """
    open_to_word = state.operating_mode in {OperatingMode.UNKNOWN, OperatingMode.MANUAL_UNSPECIFIED}
    manual = {OperatingMode.MANUAL_REDUCED, OperatingMode.MANUAL_HIGH}
    if confirmation is None or not open_to_word:
        return state
    if state.operating_mode is OperatingMode.MANUAL_UNSPECIFIED and confirmation.mode not in manual:
        return state
    until = {"operator": confirmation.operator, "confirmed_until": confirmation.until}
    if now >= confirmation.until:
        return dataclasses.replace(state, **until)  # type: ignore[arg-type]  # kept, so that the reason can be told
    return dataclasses.replace(state, operating_mode=confirmation.mode, **until)  # type: ignore[arg-type]
