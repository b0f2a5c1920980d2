"""The message types of a recording's streams and of the robot description, field by field.

They are as ROS 2 Jazzy and `calibration_interfaces` define them.  rosbags knows all types of ROS 2, but to import them
takes longer than to read a short recording.  These few are held against the bag's own definitions without them; a test
compares them with what rosbags says.
"""

from __future__ import annotations

import functools

from calibration_core.recording.definitions.fields import Types
from calibration_core.recording.definitions.own import STEP_DEFINITION, STEP_TYPE, TEXT_TYPE
from calibration_core.recording.definitions.text import parse_definition

_STAMPED = "std_msgs/Header header\n"
_THREE = "float64 x\nfloat64 y\nfloat64 z\n"
DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/msg/Point": _THREE,
    "geometry_msgs/msg/Vector3": _THREE,
    "geometry_msgs/msg/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "geometry_msgs/msg/PointStamped": _STAMPED + "geometry_msgs/Point point\n",
    "geometry_msgs/msg/WrenchStamped": _STAMPED + "geometry_msgs/Wrench wrench\n",
    "sensor_msgs/msg/JointState": _STAMPED
    + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    "sensor_msgs/msg/Temperature": _STAMPED + "float64 temperature\nfloat64 variance\n",
    TEXT_TYPE: "string data\n",
    STEP_TYPE: STEP_DEFINITION,
}
"""Type to its definition, without those of the types in it."""


@functools.cache
def stream_types(name: str) -> Types:
    """Return the fields of a type and of every type that it needs; none if it is not one of `DEFINITIONS`."""
    text = DEFINITIONS.get(name)
    return {} if text is None else parse_definition(text, name, "ros2msg", stream_types)
