"""FANUC's driver.  Its status has no header, and moves robots with the teach pendant disabled alone.

An enabled teach pendant means a manual mode, T1 or T2 is not told.

Source: FANUC-CORPORATION/fanuc_driver, fanuc_msgs/msg/{RobotStatus,RobotStatusExt}.
"""

from __future__ import annotations

import math

from calibration.robot_state.adapter import Adapter, Messages, Source, field, flag
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

MODES = {
    None: OperatingMode.UNKNOWN,
    True: OperatingMode.MANUAL_UNSPECIFIED,
    False: OperatingMode.AUTOMATIC,
}
DRIVES = {None: Drives.UNKNOWN, False: Drives.OFF, True: Drives.ON}
SAFETY = {None: SafetyState.UNKNOWN, False: SafetyState.NORMAL, True: SafetyState.EMERGENCY_STOP}


def translate(messages: Messages) -> RobotStatus:
    """Translate the latest status and extended status."""
    override = field(messages, "extended", "gen_override")
    return RobotStatus(
        operating_mode=MODES[flag(field(messages, "status", "tp_enabled"))],
        drives=DRIVES[flag(field(messages, "extended", "drives_powered"))],
        safety=SAFETY[flag(field(messages, "status", "e_stopped"))],
        motion_possible=flag(field(messages, "status", "motion_possible")),
        in_motion=flag(field(messages, "extended", "in_motion")),
        in_error=flag(field(messages, "status", "in_error")),
        speed_scaling=math.nan if override is None else float(override) / 100.0,
    )


ADAPTER = Adapter(
    "fanuc",
    (
        Source("status", "/fanuc_gpio_controller/robot_status", "fanuc_msgs/msg/RobotStatus", 0.5),
        Source("extended", "/fanuc_gpio_controller/robot_status_ext", "fanuc_msgs/msg/RobotStatusExt", 0.5),
    ),
    translate,
)
