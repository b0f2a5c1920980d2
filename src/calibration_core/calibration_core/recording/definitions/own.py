"""The message of our own, as text: so that bags can be written and read where ROS is not installed.

The same definition is built by the package `calibration_interfaces`; a test compares the two.
"""

from __future__ import annotations

from calibration_core.timeseries import Phase

STEP_TYPE = "calibration_interfaces/msg/MeasurementStep"
CONDITIONS_TYPE = "calibration_interfaces/msg/Conditions"
EVENT_TYPE = "calibration_interfaces/msg/SessionEvent"
EVENT_TOPIC = "/calibration/event"
POINT_EXCLUDED = 27  # `kind` of the event that an operator has left a point out of a configuration
TRACKER_CLOCK = 28  # `kind` of the event that tells how far a tracker's clock is off, and corrected
TEXT_TYPE = "std_msgs/msg/String"

STEP_DEFINITION = "\n".join(
    [
        *(f"uint8 {phase.name}={phase.value}" for phase in Phase),
        "std_msgs/Header header",
        "uint32 configuration",
        "uint32 step",
        "uint8 phase",
        "",
    ]
)
