"""A calibration that is applied to a task: what is corrected, what lies outside its range, what it leaves out."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.compensation.compensate import Compensation, compensate
from calibration_core.compensation.robot import CalibratedRobot
from calibration_core.compensation.task import Task
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.timeseries import Float1D, Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Applied:
    """A compensated task with what must be known of it.

    Attributes:
        task: The task.
        robot: The robot with its payload.
        found: The compensation.
        model: The model with its covariance and range.
        outside: Rows, counted from 1, beyond the model's valid range, by what is beyond: `joints`, `load`,
            `temperature`.
        remarks: What is not compensated, and what the intervals do not hold, in sentences.
    """

    task: Task
    robot: CalibratedRobot
    found: Compensation
    model: CalibratedModel
    outside: dict[str, list[int]]
    remarks: list[str]


def apply(
    robot: CalibratedRobot,
    model: CalibratedModel,
    task: Task,
    *,
    axes: str = "base",
    seed_q: Float1D | None = None,
    payload: float = 0.0,
) -> Applied:
    """Correct all rows of a task; arguments and errors as `compensate`, whose covariance is the model's."""
    found = compensate(robot, task, model.estimate, axes=axes, seed_q=seed_q, payload=payload)
    sentences = [*remarks(model, robot), *_nominal_geometry(model), *_left_aside(found)]
    return Applied(task, robot, found, model, outside(task, found.q, model), sentences)


def outside(task: Task, q: Float2D, model: CalibratedModel) -> dict[str, list[int]]:
    """Return the rows, counted from 1, beyond what the recording covered: `joints`, `load`, `temperature`."""
    covered = model.valid_range
    if covered is None:
        return {}
    force, torque = (np.linalg.norm(task.wrench[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
    beyond = {
        "joints": covered.joint_outside(q).any(axis=1),
        "load": covered.load_outside(force, torque),
        "temperature": covered.temperature_outside(task.temperature),
    }
    return {key: [int(k) + 1 for k in np.flatnonzero(rows)] for key, rows in beyond.items() if rows.any()}


def remarks(model: CalibratedModel, robot: CalibratedRobot) -> list[str]:
    """Return what the intervals of a model do not hold, in sentences."""
    if model.estimate is None:
        return ["The model file is of schema 1: it has no covariance, and nothing here has an interval."]
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
    names = sorted({effect.effect.replace("_", " ") for effect in found.aside})
    return [f"Not compensated (of the measurement, or the task lacks path, time or temperature): {', '.join(names)}."]
