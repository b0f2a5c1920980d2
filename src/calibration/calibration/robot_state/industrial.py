"""ROS-Industrial's `RobotStatus`, as Yaskawa's MotoROS2 and older drivers send it.

Source: ros-industrial/industrial_core, industrial_msgs/msg/{RobotStatus,RobotMode,TriState}.  `error_code` was a number
in ROS 1 and is a list, `error_codes`, in ROS 2.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration.robot_state.adapter import Adapter, Messages, Source, field
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

MODES: Mapping[Any, OperatingMode] = {1: OperatingMode.MANUAL_UNSPECIFIED, 2: OperatingMode.AUTOMATIC}
TRI_STATES: Mapping[Any, bool] = {0: False, 1: True}
DRIVES: Mapping[Any, Drives] = {False: Drives.OFF, True: Drives.ON}
SAFETY: Mapping[Any, SafetyState] = {False: SafetyState.NORMAL, True: SafetyState.EMERGENCY_STOP}


def translate(messages: Messages) -> RobotStatus:
    """Translate the latest status."""

    def tri(name: str) -> bool | None:
        return TRI_STATES.get(field(messages, "status", name, "val"))

    return RobotStatus(
        operating_mode=MODES.get(field(messages, "status", "mode", "val"), OperatingMode.UNKNOWN),
        drives=DRIVES.get(tri("drives_powered"), Drives.UNKNOWN),
        safety=SAFETY.get(tri("e_stopped"), SafetyState.UNKNOWN),
        motion_possible=tri("motion_possible"),
        in_motion=tri("in_motion"),
        in_error=tri("in_error"),
    )


ADAPTER = Adapter("industrial", (Source("status", "robot_status", "industrial_msgs/msg/RobotStatus"),), translate)
