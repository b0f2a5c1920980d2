"""Node `compensation`: where to send the calibrated, loaded robot so that its tool arrives, as services.

It moves nothing: whoever asks gets corrected joint angles and places, and sends them himself.  The model is a
parameter; one of another robot is refused, and the one before stays.  One request at a time; whoever comes meanwhile
is told so.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import CompensatePose, CompensateTrajectory
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from calibration.compensation.messages import (
    pose_task_of,
    request_of,
    to_pose_answer,
    to_trajectory_answer,
    trajectory_task_of,
)
from calibration.conversions import to_outcome
from calibration.node import CalibrationNode, Declared, run
from calibration.rclpy_gaps import Background
from calibration_core.cell import load_cell
from calibration_core.compensation.requests import Request
from calibration_core.compensation.robot import CalibratedRobot
from calibration_core.compensation.task import Task
from calibration_core.errors import EquilibriumError, InputError
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.model_file import read_calibrated
from calibration_core.outcomes.compensation import Applied, apply

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
