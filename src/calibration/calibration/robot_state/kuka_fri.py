"""KUKA's LBR robots through FRI.  Numbers of the operation mode differ from those of the KSS controllers.

Source: kroshu/kuka_drivers, kuka_driver_interfaces/msg/{FRIState,FRIStateArray}.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration.robot_state.adapter import Adapter, Messages, Source, field
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

MODES: Mapping[Any, OperatingMode] = {
    0: OperatingMode.MANUAL_REDUCED,
    1: OperatingMode.MANUAL_HIGH,
    2: OperatingMode.AUTOMATIC,
}  # T1, T2, AUT
DRIVES: Mapping[Any, Drives] = {0: Drives.OFF, 1: Drives.OFF, 2: Drives.ON}  # off, in transition, active
SAFETY: Mapping[Any, SafetyState] = {
    0: SafetyState.NORMAL,
    1: SafetyState.SAFEGUARD_STOP,
    2: SafetyState.SAFEGUARD_STOP,
    3: SafetyState.EMERGENCY_STOP,
}  # stop levels
COMMANDING_ACTIVE = 4


def translate(messages: Messages) -> RobotStatus:
    """Translate the state of the only robot; several robots are none that we know."""
    states = field(messages, "state", "states")
    if states is None or len(states) != 1:
        return RobotStatus()
    state = states[0]
    session = getattr(state, "session_state", None)
    return RobotStatus(
        operating_mode=MODES.get(getattr(state, "operation_mode", None), OperatingMode.UNKNOWN),
        drives=DRIVES.get(getattr(state, "drive_state", None), Drives.UNKNOWN),
        safety=SAFETY.get(getattr(state, "safety_state", None), SafetyState.UNKNOWN),
        motion_possible=None if session is None else session == COMMANDING_ACTIVE,
    )


ADAPTER = Adapter(
    "kuka_fri",
    (Source("state", "/fri_state_broadcaster/fri_state", "kuka_driver_interfaces/msg/FRIStateArray", 0.5),),
    translate,
)
