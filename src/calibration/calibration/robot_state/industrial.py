"""ROS-Industrial's `RobotStatus`, as Yaskawa's MotoROS2 and older drivers send it.

Source: ros-industrial/industrial_core, industrial_msgs/msg/{RobotStatus,RobotMode,TriState}.  `error_code` was a number
in ROS 1 and is a list, `error_codes`, in ROS 2.
"""

from __future__ import annotations

from typing import Any

from calibration.robot_state.adapter import Adapter, Messages, Source, field
from calibration_core.procedure.robot_state import Drives, OperatingMode, RobotState, Safety, Tri

MODES = {1: OperatingMode.MANUAL_UNSPECIFIED, 2: OperatingMode.AUTOMATIC}
TRI_STATES = {0: Tri.FALSE, 1: Tri.TRUE}
DRIVES = {Tri.FALSE: Drives.OFF, Tri.TRUE: Drives.ON}
SAFETY = {Tri.FALSE: Safety.NORMAL, Tri.TRUE: Safety.EMERGENCY_STOP}


def translate(messages: Messages) -> RobotState:
    """Translate the latest status."""

    def tri(name: str) -> Tri:
        return TRI_STATES.get(field(messages, "status", name, "val"), Tri.UNDECIDED)

    return RobotState(
        operating_mode=MODES.get(field(messages, "status", "mode", "val"), OperatingMode.UNKNOWN),
        drives=DRIVES.get(tri("drives_powered"), Drives.UNKNOWN),
        safety=SAFETY.get(tri("e_stopped"), Safety.UNKNOWN),
        motion_possible=tri("motion_possible"),
        in_motion=tri("in_motion"),
        in_error=tri("in_error"),
        vendor_codes=_codes(messages.get("status")),
    )


def _codes(status: Any) -> tuple[int, ...]:
    codes = getattr(status, "error_codes", None)
    if codes is None:
        code = getattr(status, "error_code", 0)
        codes = [code] if code else []
    return tuple(int(code) for code in codes)


ADAPTER = Adapter("industrial", (Source("status", "robot_status", "industrial_msgs/msg/RobotStatus"),), translate)
