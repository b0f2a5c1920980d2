"""Universal Robots' driver.

Mode and safety are topics that are sent at changes; the operational mode is a service of the dashboard; what is sent
steadily is the speed scaling, 0 to 100.  A protective or emergency stop only pauses the motion, and scaling goes to 0.

Source: UniversalRobots/Universal_Robots_ROS2_Driver, ur_dashboard_msgs/msg/{RobotMode,SafetyMode,OperationalMode},
ur_controllers/src/{gpio_controller,speed_scaling_state_broadcaster}.cpp.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from calibration.robot_state.adapter import Adapter, Messages, Source, field
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

OPERATIONAL_MODES: Mapping[Any, OperatingMode] = {
    "MANUAL": OperatingMode.MANUAL_UNSPECIFIED,
    "AUTOMATIC": OperatingMode.AUTOMATIC,
}
RUNNING = 7
# No controller, disconnected, confirm safety, booting, power off, power on (brakes closed), idle, backdrive, running,
# updating firmware.
DRIVES = {
    -1: Drives.UNKNOWN, 0: Drives.UNKNOWN, 1: Drives.OFF, 2: Drives.OFF, 3: Drives.OFF,
    4: Drives.OFF, 5: Drives.OFF, 6: Drives.OFF, RUNNING: Drives.ON, 8: Drives.OFF,
}  # fmt: skip
SAFETY = {
    1: SafetyState.NORMAL,
    2: SafetyState.REDUCED,
    3: SafetyState.PROTECTIVE_STOP,
    4: SafetyState.FAULT,  # recovery
    5: SafetyState.SAFEGUARD_STOP,
    6: SafetyState.EMERGENCY_STOP,  # of the system
    7: SafetyState.EMERGENCY_STOP,  # of the robot
    8: SafetyState.FAULT,  # violation
    9: SafetyState.FAULT,
    10: SafetyState.FAULT,  # validating joint ids
    11: SafetyState.UNKNOWN,
    12: SafetyState.SAFEGUARD_STOP,  # in automatic mode
    13: SafetyState.ENABLING_STOP,  # three-position switch
}


def translate(messages: Messages) -> RobotStatus:
    """Translate the latest mode, safety mode, program state, operational mode and speed scaling."""
    mode = field(messages, "robot_mode", "mode")
    asked = messages.get("operational_mode")
    word = field(messages, "operational_mode", "operational_mode", "mode") if getattr(asked, "success", False) else None
    program = field(messages, "program", "data")
    scaling = field(messages, "scaling", "data")
    return RobotStatus(
        operating_mode=OPERATIONAL_MODES.get(word, OperatingMode.UNKNOWN),
        drives=DRIVES.get(mode, Drives.UNKNOWN),
        safety=SAFETY.get(field(messages, "safety_mode", "mode"), SafetyState.UNKNOWN),
        motion_possible=None if program is None or mode is None else program and mode == RUNNING,
        speed_scaling=math.nan if scaling is None else float(scaling) / 100.0,
    )


_STATUS = "/io_and_status_controller"
ADAPTER = Adapter(
    "ur",
    (
        Source("robot_mode", f"{_STATUS}/robot_mode", "ur_dashboard_msgs/msg/RobotMode", None),
        Source("safety_mode", f"{_STATUS}/safety_mode", "ur_dashboard_msgs/msg/SafetyMode", None),
        Source("program", f"{_STATUS}/robot_program_running", "std_msgs/msg/Bool", None),
        Source("scaling", "/speed_scaling_state_broadcaster/speed_scaling", "std_msgs/msg/Float64", 0.5),
        Source(
            "operational_mode",
            "/dashboard_client/get_operational_mode",
            "ur_dashboard_msgs/srv/GetOperationalMode",
            3.0,
        ),
    ),
    translate,
)
