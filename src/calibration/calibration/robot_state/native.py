"""Our own `calibration_interfaces/msg/RobotState`, from a driver that speaks it (the simulated cell does)."""

from __future__ import annotations

import enum
import math
from typing import Any, TypeVar

from calibration.robot_state.adapter import Adapter, Messages, Source
from calibration_core.procedure.robot_state import Drives, OperatingMode, RobotState, Safety, Tri

Word = TypeVar("Word", bound=enum.IntEnum)
MILLI = 1e-3


def translate(messages: Messages) -> RobotState:
    """Take over the latest state; a number that stands for nothing is UNKNOWN."""
    state = messages.get("state")
    if state is None:
        return RobotState()
    return RobotState(
        operating_mode=_word(state.operating_mode, OperatingMode.UNKNOWN),
        drives=_word(state.drives, Drives.UNKNOWN),
        safety=_word(state.safety, Safety.UNKNOWN),
        motion_possible=_word(state.motion_possible, Tri.UNDECIDED),
        in_motion=_word(state.in_motion, Tri.UNDECIDED),
        in_error=_word(state.in_error, Tri.UNDECIDED),
        speed_scaling=state.speed_scaling if math.isfinite(state.speed_scaling) else math.nan,
        speed_limit=MILLI * state.speed_limit_mm_s if math.isfinite(state.speed_limit_mm_s) else math.nan,
        vendor_codes=tuple(int(code) for code in state.vendor_codes),
    )


def _word(value: Any, unknown: Word) -> Word:
    try:
        return type(unknown)(value)
    except ValueError:
        return unknown


ADAPTER = Adapter("native", (Source("state", "robot_state", "calibration_interfaces/msg/RobotState", 0.5),), translate)
