"""ABB's driver (RWS).  Manual is one mode: reduced or full speed is not told, so an operator has to say which.

When the connection to the controller fails, the driver goes on sending the last state with new stamps: the state alone
never proves that the controller is there, joint states do.

Source: PickNikRobotics/abb_ros2, ros-industrial/abb_robot_driver_interfaces, abb_robot_msgs/msg/SystemState.
"""

from __future__ import annotations

from calibration.robot_state.adapter import Adapter, Messages, Source, field, flag
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

MODES = {
    None: OperatingMode.UNKNOWN,
    False: OperatingMode.MANUAL_UNSPECIFIED,
    True: OperatingMode.AUTOMATIC,
}
DRIVES = {None: Drives.UNKNOWN, False: Drives.OFF, True: Drives.ON}
# Motors cannot be on while a safety chain is open; with motors off nothing is known about it.
SAFETY = {None: SafetyState.UNKNOWN, False: SafetyState.UNKNOWN, True: SafetyState.NORMAL}


def translate(messages: Messages) -> RobotStatus:
    """Translate the latest system state."""
    motors = flag(field(messages, "system", "motors_on"))
    return RobotStatus(
        operating_mode=MODES[flag(field(messages, "system", "auto_mode"))],
        drives=DRIVES[motors],
        safety=SAFETY[motors],
        motion_possible=flag(field(messages, "system", "rapid_running")),
    )


ADAPTER = Adapter(
    "abb", (Source("system", "rws_client/system_states", "abb_robot_msgs/msg/SystemState", 0.6),), translate
)
