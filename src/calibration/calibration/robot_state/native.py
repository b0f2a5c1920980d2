"""Our own `calibration_interfaces/msg/RobotState`, from a driver that speaks it (the simulated cell does)."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from typing import Any, TypeVar

from calibration.robot_state.adapter import Adapter, Messages, Source
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

Word = TypeVar("Word", bound=enum.IntEnum)
MILLI = 1e-3
TRI_STATES: Mapping[Any, bool] = {0: False, 1: True}  # anything else: not said


def translate(messages: Messages) -> RobotStatus:
    """Take over the latest state; a number that stands for nothing is UNKNOWN."""
    state = messages.get("state")
    if state is None:
        return RobotStatus()
    return RobotStatus(
        operating_mode=_word(state.operating_mode, OperatingMode.UNKNOWN),
        drives=_word(state.drives, Drives.UNKNOWN),
        safety=_word(state.safety, SafetyState.UNKNOWN),
        motion_possible=TRI_STATES.get(state.motion_possible),
        in_motion=TRI_STATES.get(state.in_motion),
        in_error=TRI_STATES.get(state.in_error),
        speed_scaling=state.speed_scaling if math.isfinite(state.speed_scaling) else math.nan,
        speed_limit=MILLI * state.speed_limit_mm_s if math.isfinite(state.speed_limit_mm_s) else math.nan,
    )


def _word(value: Any, unknown: Word) -> Word:
    try:
        return type(unknown)(value)
    except ValueError:
        return unknown


ADAPTER = Adapter(
    "native", (Source("state", "driver/robot_state", "calibration_interfaces/msg/RobotState", 0.5),), translate
)
