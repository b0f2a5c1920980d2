"""The requests and answers of the node `compensation` as values of the core, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from calibration_interfaces.msg import Outcome
from geometry_msgs.msg import Pose, Quaternion
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from calibration.conversions import to_outcome, to_point, wrench_values
from calibration_core.compensation.compensate import OK
from calibration_core.compensation.requests import (
    Request,
    ordered,
    place_task,
    quaternions,
    trajectory_task,
)
from calibration_core.compensation.tables import duration
from calibration_core.compensation.task import Task
from calibration_core.errors import InputError
from calibration_core.outcomes.compensation import Applied
from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D


def request_of(message: Any) -> Request:
    """Return what a request says besides its task.

    Raises:
        InputError: It makes no sense.
    """
    payload = (float(message.payload_mass), *_xyz(message.payload_centre))
    warm = list(message.temperature)
    return Request(message.axes or "base", payload if any(payload) else None, warm[0] if warm else None)


def pose_task_of(message: Any, request: Request, joints: tuple[str, ...]) -> Task:
    """Return the task of a `CompensatePose` request.

    Raises:
        InputError: It makes no sense.
    """
    q = np.array(message.q)
    if list(message.joints):
        places = ordered(joints, message.joints, "joints")
        if len(q) != len(joints):
            raise InputError("request", "q", f"{len(q)} values", f"{len(joints)}, one per name in joints")
        q = q[places]
    turn = message.target.orientation
    pose = np.array(_xyz(message.target.position)), np.array([turn.x, turn.y, turn.z, turn.w])
    target = None if message.target_of_joints else pose
    return place_task(request, target, q if len(q) else None, wrench_values(message.wrench), len(joints))


def trajectory_task_of(message: Any, request: Request, joints: tuple[str, ...]) -> Task:
    """Return the task of a `CompensateTrajectory` request.

    Raises:
        InputError: It makes no sense.
    """
    names, points = list(message.trajectory.joint_names), message.trajectory.points
    places = ordered(joints, names, "trajectory.joint_names")
    times = np.array([one.time_from_start.sec + one.time_from_start.nanosec / NANOSECONDS for one in points])
    wrenches = np.array([wrench_values(one) for one in message.wrenches]).reshape(-1, 6)
    rates = _rates_of(message.trajectory, places)
    return trajectory_task(request, _rows(points, "positions", places), times, wrenches, rates)


def to_pose_answer(applied: Applied, response: Any) -> Any:
    """Fill the answer to a `CompensatePose` request."""
    found = applied.found
    response.status = found.status[0]
    if found.ok[0]:
        response.joints = list(applied.robot.chain.joints)
        response.q = found.q[0].tolist()
        response.corrected = _poses(applied)[0]
    before, after = found.lengths
    response.error_before, response.error_after = float(before[0]), float(after[0])
    response.u95 = float(found.u95[0])
    return _filled(applied, response)


def to_trajectory_answer(applied: Applied, request: Any, response: Any) -> Any:
    """Fill the answer to a `CompensateTrajectory` request; the trajectory stays empty where a point was refused."""
    found = applied.found
    response.status = list(found.status)
    before, after = found.lengths
    response.error_before, response.error_after = before.tolist(), after.tolist()
    response.u95 = found.u95.tolist()
    if found.ok.all():
        response.corrected = _poses(applied)
        response.trajectory = _trajectory(applied, request.trajectory)
    return _filled(applied, response)


def _filled(applied: Applied, response: Any) -> Any:
    response.outside, response.remarks = list(applied.outside), list(applied.remarks)
    refused = [(k, status) for k, status in enumerate(applied.found.status) if status != OK]
    code, text = Outcome.OK, ""
    if refused:
        code, text = Outcome.NOT_REACHED, f"point {refused[0][0]}: {refused[0][1]}; {len(refused)} refused"
    response.outcome = to_outcome(code, text)
    return response


def _trajectory(applied: Applied, asked: Any) -> JointTrajectory:
    """Return the corrected trajectory, joints in the order of the request; without accelerations and efforts."""
    names, found = list(asked.joint_names), applied.found
    joints = applied.robot.chain.joints
    back = [joints.index(name) for name in names]
    points = []
    for k, q in enumerate(found.q[:, back]):
        point = JointTrajectoryPoint(positions=q.tolist(), time_from_start=Duration(**duration(applied.task.time[k])))
        if applied.rate is not None:
            point.velocities = applied.rate[k, back].tolist()
        points.append(point)
    return JointTrajectory(header=asked.header, joint_names=names, points=points)


def _poses(applied: Applied) -> list[Pose]:
    found = applied.found
    turns = quaternions(found.sent_axes)
    return [
        Pose(position=to_point(origin), orientation=Quaternion(**dict(zip("xyzw", map(float, turn), strict=True))))
        for origin, turn in zip(found.sent.T, turns, strict=True)
    ]


def _rates_of(trajectory: Any, places: list[int]) -> Float2D | None:
    """Return the velocities (m, n) rad/s of a trajectory, joints in the robot's order; None where it has none."""
    if not any(len(one.velocities) for one in trajectory.points):
        return None
    return _rows(trajectory.points, "velocities", places)


def _rows(points: Any, field: str, places: list[int]) -> Float2D:
    """Return one field of the points of a trajectory, (m, n), joints in the robot's order."""
    rows: list[Float1D] = []
    for k, point in enumerate(points):
        values = np.array(getattr(point, field))
        if len(values) != len(places):
            found, expected = f"{len(values)} values", f"{len(places)}, one per joint"
            raise InputError("request", f"trajectory.points[{k}].{field}", found, expected)
        rows.append(values[places])
    return np.array(rows).reshape(-1, len(places))


def _xyz(one: Any) -> list[float]:
    return [float(one.x), float(one.y), float(one.z)]
