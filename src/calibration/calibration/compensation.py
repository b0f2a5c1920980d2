"""Node `compensation`: where to send the calibrated, loaded robot so that its tool arrives, as services.

It moves nothing: whoever asks gets corrected joint angles and places, and sends them himself.  The model is a
parameter; one of another robot is refused, and the one before stays.  One request at a time; whoever comes meanwhile
gets that as the answer.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import CompensatePose, CompensateTrajectory
from geometry_msgs.msg import Pose, Quaternion
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from calibration.conversions import to_outcome, to_point, wrench_values
from calibration.node import CalibrationNode, Declared, run
from calibration.rclpy_gaps import Background
from calibration_core.cell import load_cell
from calibration_core.compensation.compensate import OK
from calibration_core.compensation.requests import (
    Request,
    ordered,
    place_task,
    quaternions,
    trajectory_task,
)
from calibration_core.compensation.robot import CalibratedRobot
from calibration_core.compensation.tables import duration
from calibration_core.compensation.task import Task
from calibration_core.errors import EquilibriumError, InputError
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.model_file import read_calibrated
from calibration_core.outcomes.compensation import Applied, apply
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


PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("model", "", "The model file of `identify` or `diagnose`; empty: none yet.", read_only=False),
)
MANY = QoSProfile(depth=1000)  # requests at once: those beyond it would never be answered


class CompensationNode(CalibrationNode):
    """Offers `~/compensate_pose` and `~/compensate_trajectory`."""

    def __init__(self, **kwargs: Any) -> None:
        """Make the node.

        Raises:
            InputError: A parameter, the cell file or the model file cannot be used.
        """
        self._model: CalibratedModel | None = None
        self._working = threading.Lock()
        super().__init__("compensation", PARAMETERS, **kwargs)

    def on_start(self) -> None:
        """Read cell and model, and offer the services."""
        self.cell = load_cell(self.value("cell"))
        self._model = self._read(self.value("model"))
        group = ReentrantCallbackGroup()
        for kind, name, answer in (
            (CompensatePose, "~/compensate_pose", self._on_pose),
            (CompensateTrajectory, "~/compensate_trajectory", self._on_trajectory),
        ):
            self.create_service(kind, name, answer, qos_profile=MANY, callback_group=group)
        self._show_status()

    def _read(self, file: str) -> CalibratedModel | None:
        return read_calibrated(Path(file), self.cell) if file else None

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take a new model where it belongs to the robot; another one is refused, and nothing changes."""
        answer = super()._check(parameters)
        given = [one for one in parameters if one.name == "model"]
        if not answer.successful or not given or not hasattr(self, "cell"):
            return answer
        try:
            self._model = self._read(given[-1].value)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._show_status()
        return answer

    def _show_status(self) -> None:
        """Say in the diagnostics whether there is a model."""
        self.diagnostics.report("model", 0, "none yet" if self._model is None else "read")

    def busy(self) -> str:
        """Say what is under way that forbids to change the model."""
        return "a compensation is under way" if self._working.locked() else ""

    async def _on_pose(self, request: Any, response: Any) -> Any:
        return await self._answered(request, response, pose_task_of, to_pose_answer)

    async def _on_trajectory(self, request: Any, response: Any) -> Any:
        def fill(applied: Applied, response: Any) -> Any:
            return to_trajectory_answer(applied, request, response)

        return await self._answered(request, response, trajectory_task_of, fill)

    async def _answered(
        self,
        message: Any,
        response: Any,
        task_of: Callable[[Any, Request, tuple[str, ...]], Task],
        fill: Callable[[Applied, Any], Any],
    ) -> Any:
        """Convert, call the core beside the executor, convert back."""
        model = self._model
        if model is None:
            text = "model: found nothing, expected a model file as parameter of the node"
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, text)
            return response
        if not self._working.acquire(blocking=False):
            response.outcome = to_outcome(Outcome.BUSY, "another compensation is under way")
            return response

        def work() -> Any:
            request = request_of(message)
            robot = CalibratedRobot.of(self.cell, model.parameters, request.payload)
            task = task_of(message, request, robot.chain.joints)
            return fill(apply(robot, model, task, axes=request.axes), response)

        try:
            return await Background(self, work)
        except (InputError, EquilibriumError) as error:
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, str(error))
            return response
        finally:
            self._working.release()


def main(arguments: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(CompensationNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
