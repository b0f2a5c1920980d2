"""What the simulated cell's node says and understands: its parameters, and messages to numbers and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from calibration_interfaces.msg import RobotState
from geometry_msgs.msg import Vector3, Wrench
from trajectory_msgs.msg import JointTrajectory

from calibration_core.timeseries import NANOSECONDS, Float1D
from calibration_sim.living_cell.faults import Faults, Kind
from calibration_sim.living_cell.live import Path, Refused

PARAMETERS: dict[str, tuple[Any, str]] = {
    "cell": ("", "Cell file."),
    "seed": (1, "Of the hidden truth and of the noise."),
    "truth": (
        "draw",
        "nominal, draw (other stiffnesses), workshop or uncalibrated (all else wrong, too).",
    ),
    "concealed_joint": ("", "Joint whose bearing tilts, which no cell file says; empty: none."),
    "concealed_compliance": (2.0e-7, "rad/(N*m), of that bearing about one axis across the joint's."),
    "speed": (1.0, "Multiple of real time."),
    "clock": (False, "Whether /clock is sent and stamps begin at a fixed date; needed for a speed other than 1."),
    "clock_rate": (100.0, "Hz of wall time, of /clock."),
    "rates.joints": (100.0, "Hz of the cell's time."),
    "rates.tracker": (10.0, "Hz of the cell's time, every point."),
    "tracker": ("stream", "stream (every point at once) or line (one beam, aimed as config/trackers/plain.yaml says)."),
    "tracker_address": ("127.0.0.1:7000", "Where the one beam is asked, for line."),
    "tracker_clock_offset": (0.0, "s, that the stamps of the points are ahead at the beginning."),
    "tracker_clock_rate": (1.0, "s of those stamps in one of the cell's."),
    "rates.wrench": (50.0, "Hz of the cell's time."),
    "rates.temperature": (0.5, "Hz of the cell's time."),
    "rates.state": (50.0, "Hz of the cell's time, of the robot state; it is sent at changes, too."),
    "window": (2.0, "s, the averaging window over which the instruments' claims hold."),
    "load_ramp": (2.0, "s, every change of load."),
    "home": ([0.0], "rad, where the robot stands at first, one per joint; a single 0: all zero, within the limits."),
    "operating_mode": (RobotState.MODE_MANUAL_REDUCED, "RobotState.MODE_* that is reported."),
    "motion_log": ("", "File for the true angles at every millisecond of motion; empty: none."),
    "truth_log": ("", "File for angles, load and true points at every reading of the tracker; empty: none."),
    "fault": ("", "Fault that begins when this is set: KIND [VALUE [POINT]]; NONE ends all (see `Kind`)."),
    "event_log": ("", "File for faults and commands with the monotonic clock's ns; empty: none."),
}


def wrench_message(values: Float1D) -> Wrench:
    """Return (6,) N and N*m as a message."""
    fx, fy, fz, tx, ty, tz = values.tolist()
    return Wrench(force=Vector3(x=fx, y=fy, z=fz), torque=Vector3(x=tx, y=ty, z=tz))


def wrench_values(wrench: Wrench) -> Float1D:
    """Return (6,) N and N*m."""
    force, torque = wrench.force, wrench.torque
    return np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])


def path_of(trajectory: JointTrajectory, joints: tuple[str, ...]) -> Path | None:
    """Return the path that a trajectory asks for, joints in the cell's order; None if it has one point: hold.

    Raises:
        Refused: Joints are missing, or a point lacks a position or velocity.
    """
    names = list(trajectory.joint_names)
    if sorted(names) != sorted(joints):
        raise Refused(f"joints {names}")
    order = [names.index(joint) for joint in joints]
    points = trajectory.points
    if len(points) == 1:
        return None
    seconds = np.array([p.time_from_start.sec + p.time_from_start.nanosec / NANOSECONDS for p in points])
    try:
        position = np.array([list(p.positions) for p in points], dtype=np.float64)[:, order]
        velocity = np.array([list(p.velocities) for p in points], dtype=np.float64)[:, order]
    except (ValueError, IndexError):
        raise Refused("points without a position and a velocity for every joint") from None
    return Path(seconds, position, velocity)


def reported(faults: Faults, *, mode: int, moving: bool) -> dict[str, Any]:
    """Return what the controller reports, as fields of `RobotState`."""
    stopped = faults.on(Kind.EMERGENCY_STOP)
    return {
        "operating_mode": RobotState.MODE_AUTOMATIC if faults.on(Kind.MODE_FLIP) else mode,
        "drives": RobotState.DRIVES_OFF if faults.on(Kind.SERVO_OFF) else RobotState.DRIVES_ON,
        "safety": RobotState.SAFETY_EMERGENCY_STOP if stopped else RobotState.SAFETY_NORMAL,
        "motion_possible": RobotState.FALSE if stopped else RobotState.TRUE,
        "in_motion": RobotState.TRUE if moving and not stopped else RobotState.FALSE,
        "in_error": RobotState.FALSE,
        "speed_scaling": 0.0 if stopped else 1.0,
    }
