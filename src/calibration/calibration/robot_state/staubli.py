"""Stäubli's controllers through the ros2_control driver: values of named interfaces, all as float.

Source: ICube-Robotics/staubli_driver_ros2, staubli_robot_driver/types.hpp; ros-controls/control_msgs,
DynamicInterfaceGroupValues (group names, and per group interface names and values).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration.robot_state.adapter import Adapter, Messages, Source, flag
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

MODES: Mapping[Any, OperatingMode] = {
    1: OperatingMode.MANUAL_UNSPECIFIED,
    2: OperatingMode.AUTOMATIC,
    3: OperatingMode.EXTERNAL,
}
DRIVES = {None: Drives.UNKNOWN, False: Drives.OFF, True: Drives.ON}
SAFETY: Mapping[Any, SafetyState] = {
    0: SafetyState.NORMAL,
    1: SafetyState.PROTECTIVE_STOP,  # waits for restart
    2: SafetyState.SAFEGUARD_STOP,  # SS1
    3: SafetyState.SAFEGUARD_STOP,  # SS2
    4: SafetyState.ENABLING_STOP,  # waits for the working mode selector
}


def translate(messages: Messages) -> RobotStatus:
    """Translate the latest values of the group `supervision`."""
    values = interface_values(messages.get("states"), "supervision")
    pressed = _flag(values, "estop_pressed")
    safety = SAFETY.get(values.get("safety_status"), SafetyState.UNKNOWN)
    if pressed:
        safety = SafetyState.EMERGENCY_STOP
    elif pressed is None:
        safety = SafetyState.UNKNOWN
    return RobotStatus(
        operating_mode=MODES.get(values.get("operation_mode"), OperatingMode.UNKNOWN),
        drives=DRIVES[_flag(values, "power_on")],
        safety=safety,
        motion_possible=_flag(values, "motion_possible"),
        in_motion=_flag(values, "in_motion"),
        in_error=_flag(values, "in_error"),
    )


def interface_values(message: Any, group: str) -> Mapping[str, int]:
    """Return the values of one group by name; values that are no whole numbers are left out."""
    groups = list(getattr(message, "interface_groups", ()))
    if group not in groups:
        return {}
    found = message.interface_values[groups.index(group)]
    pairs = zip(found.interface_names, found.values, strict=False)
    return {name: int(value) for name, value in pairs if float(value).is_integer()}


def _flag(values: Mapping[str, int], name: str) -> bool | None:
    return flag(values[name]) if values.get(name) in {0, 1} else None


ADAPTER = Adapter(
    "staubli",
    (Source("states", "/gpio_controller/gpio_states", "control_msgs/msg/DynamicInterfaceGroupValues", 0.5),),
    translate,
)
