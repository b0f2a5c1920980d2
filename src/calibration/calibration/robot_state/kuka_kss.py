"""KUKA's KSS controllers through the EKI or mxAutomation interface.

The status comes once a second and only while the interface is idle: it says whether a motion may begin, and is too slow
to stop one; joint states must do that.

Source: kroshu/kuka_drivers, kuka_driver_interfaces/msg/{KssStatus,KssStatusArray}.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration.robot_state.adapter import Adapter, Messages, Source, field, flag
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

MODES: Mapping[Any, OperatingMode] = {
    1: OperatingMode.MANUAL_REDUCED,  # T1
    2: OperatingMode.MANUAL_HIGH,  # T2
    3: OperatingMode.AUTOMATIC,
    4: OperatingMode.EXTERNAL,
}
DRIVES = {None: Drives.UNKNOWN, False: Drives.OFF, True: Drives.ON}


def translate(messages: Messages) -> RobotStatus:
    """Translate the status of the only robot; several robots are none that we know."""
    statuses = field(messages, "status", "statuses")
    if statuses is None or len(statuses) != 1:
        return RobotStatus()
    status = statuses[0]
    return RobotStatus(
        operating_mode=MODES.get(getattr(status, "operation_mode", None), OperatingMode.UNKNOWN),
        drives=DRIVES[flag(getattr(status, "drives_powered", None))],
        safety=_safety(flag(getattr(status, "emergency_stop", None)), flag(getattr(status, "guard_stop", None))),
        motion_possible=flag(getattr(status, "motion_possible", None)),
        in_motion=flag(getattr(status, "in_motion", None)),
    )


def _safety(emergency: bool | None, guard: bool | None) -> SafetyState:
    if emergency:
        return SafetyState.EMERGENCY_STOP
    if guard:
        return SafetyState.SAFEGUARD_STOP
    return SafetyState.NORMAL if emergency is guard is False else SafetyState.UNKNOWN


ADAPTER = Adapter(
    "kuka_kss",
    (Source("status", "/kss_message_handler/status", "kuka_driver_interfaces/msg/KssStatusArray", 3.0),),
    translate,
)
