"""A calibration that is applied to a task: what is corrected, what lies outside its range, what it leaves out."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.compensation.compensate import Compensation, compensate, nominal_angles
from calibration_core.compensation.deflection import Deflection, PlaneMap, deflect, plane_map
from calibration_core.compensation.limits import GRAVITY, OVERLOAD, outside
from calibration_core.compensation.requests import corrected_rates
from calibration_core.compensation.robot import CalibratedRobot, Conditions
from calibration_core.compensation.tables import times_of
from calibration_core.compensation.task import Task
from calibration_core.errors import InputError, rounded_down
from calibration_core.model.effects.words import effect_words
from calibration_core.model.identified.calibrated import WITHOUT_INTERVALS, CalibratedModel
from calibration_core.motion.speed import SAFETY_RATED_SPEED, Monitored, first_beyond
from calibration_core.timeseries import Float1D, Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Applied:
    """A compensated task with what must be known of it.

    Attributes:
        robot: The robot with its payload.
        found: The compensation.
        model: The model with its covariance and range.
        outside: Rows, counted from 1, beyond the model's valid range, by what is beyond: `joints`, `load`,
            `temperature`.
        remarks: What is not compensated, and what the intervals do not hold, in sentences.
        time: (k,) s from the first, when each of the k compensated rows is reached: as the task says where every row
            has a time, else as soon as no monitored point exceeds 250 mm/s.
        rate: (m, n) rad/s, m/s where a joint slides: the task's joint rates with the change of the correction added;
            None where the task has none.
    """

    task: Task
    robot: CalibratedRobot
    found: Compensation
    model: CalibratedModel
    outside: dict[str, list[int]]
    remarks: list[str]
    time: Float1D
    rate: Float2D | None


def apply(
    robot: CalibratedRobot,
    model: CalibratedModel,
    task: Task,
    *,
    axes: str = "base",
    seed_q: Float1D | None = None,
) -> Applied:
    """Correct all rows of a task; arguments as `compensate`, whose covariance is the model's.

    Raises:
        CellError: There is a load, and the cell file has no wrench point.
        InputError: Angles are in degrees, or travels in millimetres; or the times of the task let a monitored point of
            the robot move faster than 250 mm/s, with the corrections or without.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    found = compensate(robot, task, model.estimate, axes=axes, seed_q=seed_q)
    sentences = [*task.remarks, *remarks(model, robot), *_nominal_geometry(model)]
    sentences += [*_left_aside(found), *_untimed(task, found)]
    rate = None if task.rate is None else corrected_rates(found.nominal, found.q, task.time, task.rate)
    time = _timed(robot, task, found, rate)
    return Applied(task, robot, found, model, outside(task, found.q, robot, model), sentences, time, rate)


def _timed(robot: CalibratedRobot, task: Task, found: Compensation, rate: Float2D | None) -> Float1D:
    """Return when each compensated row is reached, (k,) s from the first, so that no monitored point is too fast.

    Raises:
        InputError: The times of the task make a monitored point faster than 250 mm/s.
    """
    monitored = Monitored.of(robot.chain, robot.parameters, robot.tool[:3, 3])
    rows = np.flatnonzero(found.ok)
    given = task.time[rows]
    if not np.isfinite(given).all():
        return times_of(found.q[rows], monitored.lever, SAFETY_RATED_SPEED)
    fastest = first_beyond(monitored, given, found.q[rows], None if rate is None else rate[rows], SAFETY_RATED_SPEED)
    if fastest is None:
        return np.asarray(given - given[:1])
    interval, point, speed = fastest
    pair = rows[interval : interval + 2]
    nominal = first_beyond(
        monitored, task.time[pair], found.nominal[pair], None if task.rate is None else task.rate[pair], 0.0
    )
    without = 0.0 if nominal is None else nominal[2]
    how = f"{monitored.names[point]} at up to {math.ceil(1e4 * speed) / 10:.1f} mm/s on the way there"
    raise task.fault(
        int(pair[1]),
        f"{how} ({1e3 * without:.1f} mm/s without the correction)",
        f"at most {1e3 * SAFETY_RATED_SPEED:.0f} mm/s for every point of the robot: more time after the row before",
    )


def remarks(model: CalibratedModel, robot: CalibratedRobot) -> list[str]:
    """Return what the intervals of a model do not hold, in sentences."""
    if model.estimate is None:
        return [WITHOUT_INTERVALS]
    known = set(model.estimate.names)
    believed = [
        joint
        for joint, compliance in zip(robot.chain.joints, robot.parameters.compliance, strict=True)
        if compliance > 0 and f"compliance.{joint}" not in known
    ]
    unknown = [name for name in model.estimate.unknown if name.startswith("compliance.")]
    sentences = []
    if believed:
        sentences.append(f"Stiffness taken from the cell file, without interval: {', '.join(believed)}.")
    if unknown:
        joints = ", ".join(name.removeprefix("compliance.") for name in unknown)
        sentences.append(
            f"The recording says nothing of the stiffness of {joints}: where it counts, intervals are infinite."
        )
    if not robot.chain.inertials_known or robot.chain.mass is None:
        sentences.append("Masses of the links are not known: sag under the weight is what the geometry has taken up.")
    return sentences


def _nominal_geometry(model: CalibratedModel) -> list[str]:
    """Say that places rest on the cell file's geometry: deflections do not, wherever the tool should arrive does."""
    if model.estimate is None or any(name.startswith("geometry.") for name in model.estimate.names):
        return []
    text = "The geometry was not identified, and the cell file's counts as exact: the tool may miss its target by more"
    return [f"{text} than the intervals say (calibration plan --phases measures the geometry, too)."]


def _left_aside(found: Compensation) -> list[str]:
    if not found.aside:
        return []
    names = sorted({effect_words(effect.effect) for effect in found.aside})
    return [f"Not compensated (of the measurement, or the task lacks path, time or temperature): {', '.join(names)}."]


def _untimed(task: Task, found: Compensation) -> list[str]:
    known = np.isfinite(task.time[found.ok])
    if known.all() or not known.any():
        return []
    text = "Some rows have no time: the trajectory is timed so that no point of the robot exceeds 250 mm/s"
    return [f"{text}, and not by the task."]


# --- what a load does to a calibrated robot ---------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Deflected:
    """What a load does, with what the report says of it.

    Attributes:
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
