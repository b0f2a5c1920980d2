"""Trajectories as drivers take them: the form that every driver accepts.

Stamp zero (begin at once), all joints in the configured order, the first point where the robot stands, at time zero and
at rest, strictly increasing times, positions and velocities at every point, the last at rest.
"""

from __future__ import annotations

from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from calibration_core.motion.trajectory import Trajectory, halt
from calibration_core.timeseries import NANOSECONDS, Float1D


def to_duration(seconds: float) -> Duration:
    """Return s as a message."""
    whole = round(seconds * NANOSECONDS)
    return Duration(sec=whole // NANOSECONDS, nanosec=whole % NANOSECONDS)


def to_joint_trajectory(trajectory: Trajectory) -> JointTrajectory:
    """Return a trajectory as a message."""
    rows = zip(trajectory.time.tolist(), trajectory.position.tolist(), trajectory.velocity.tolist(), strict=True)
    return JointTrajectory(
        joint_names=list(trajectory.joints),
        points=[
            JointTrajectoryPoint(positions=position, velocities=velocity, time_from_start=to_duration(time))
            for time, position, velocity in rows
        ],
    )


def hold(joints: tuple[str, ...], q: Float1D, rate: Float1D, age: float) -> JointTrajectory:
    """Return the trajectory that stops a controller: one point, where the robot comes to rest; arguments of `halt`."""
    where, seconds = halt(q, rate, age)
    point = JointTrajectoryPoint(
        positions=where.tolist(), velocities=[0.0] * len(q), time_from_start=to_duration(seconds)
    )
    return JointTrajectory(joint_names=list(joints), points=[point])
