"""What a load does to a calibrated robot."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.compensation.compensate import nominal_angles
from calibration_core.compensation.deflection import Deflection, PlaneMap, deflect, plane_map
from calibration_core.compensation.limits import GRAVITY, OVERLOAD, outside
from calibration_core.compensation.robot import CalibratedRobot, Conditions
from calibration_core.compensation.task import Task
from calibration_core.errors import InputError, rounded_down
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.outcomes.compensation import remarks
from calibration_core.timeseries import Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Deflected:
    """What a load does, with what the report says of it.

    Attributes:
        task: Places and wrenches.
        robot: The robot with its payload.
        q: (m, n) rad.
        found: The deflections.
        chart: Over a plane through the first place; None without a load there.
        outside: Rows, counted from 1, beyond the model's valid range, by what is beyond: `joints`, `load`,
            `temperature`.
        remarks: What of the task was not used, and what the intervals do not hold, in sentences.
    """

    task: Task
    robot: CalibratedRobot
    q: Float2D
    found: Deflection
    chart: PlaneMap | None
    outside: dict[str, list[int]]
    remarks: list[str]

    @property
    def reference(self) -> str:
        """Against what the load moves the robot, in words."""
        return _reference(self.robot)


def deflected(robot: CalibratedRobot, model: CalibratedModel, task: Task, *, axes: str, plane: str | None) -> Deflected:
    """Predict what the wrenches of a task do.

    Args:
        robot: The robot with its payload.
        model: Its model.
        task: Places and wrenches.
        axes: Axes of the wrenches: `base` or `tool`.
        plane: Plane of the map: `xy`, `xz` or `yz`; None: no map.

    Raises:
        InputError: Nothing pulls, a place is out of reach, a load is beyond the rated load, or angles are in degrees.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    if not np.any(task.wrench):
        raise InputError("--wrench", "", "no load", "a wrench other than zero: --wrench, or fx ... tz in the file")
    q, refused = nominal_angles(task, robot)
    if refused:
        row, why = refused[0]
        reached = "a place that the robot reaches within its limits"
        most = rounded_down(robot.cell.robot.rated_load * GRAVITY)
        rated = f"at most {most:g} N with the payload (robot.rated_load of the cell)"
        raise task.fault(row, why, rated if why == OVERLOAD else reached, of_load=why == OVERLOAD)
    conditions = Conditions(task.time, task.temperature, task.path)
    found = deflect(robot, q, task.wrench, conditions, model.estimate, axes)
    chart = None if plane is None else plane_map(robot, q[0], task.wrench[0], plane, axes)
    sentences = [*task.remarks, *remarks(model, robot)]
    if robot.payload:
        sentences.append(f"What the load does is against {_reference(robot)}: what the payload does is not in it.")
    return Deflected(task, robot, q, found, chart, outside(task, q, robot, model), sentences)


def _reference(robot: CalibratedRobot) -> str:
    payload = f" and that of its payload of {robot.payload:g} kg" if robot.payload else ""
    return f"the robot under its own weight{payload}"
