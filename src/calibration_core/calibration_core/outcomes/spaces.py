"""What plans and schedules look like in space: points, loads and deflections of every configuration."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.checks.space import operating_space
from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.model.chain import pose_matrix
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import Schedule
from calibration_core.model.statics import Load
from calibration_core.planning.plans.plan import Plan
from calibration_core.timeseries import Float3D, Provenance, Readings


def scheduled_space(schedule: Schedule, cell: Cell, parameters: ModelParameters) -> OperatingSpace:
    """Return the operating space of what is to be measured, one entry per configuration at its largest load.

    Raises:
        EquilibriumError: A load is beyond what the joints can carry.
    """
    steps = len(schedule.step)
    readings = Readings(
        points=tuple(parameters.points),
        configuration=schedule.configuration,
        step=schedule.step,
        point=np.zeros(steps, dtype=np.int64),
        q=schedule.q,
        position=np.zeros((steps, 3)),
        wrench=None,
        time=np.full(steps, np.nan),
        temperature=np.full(steps, np.nan),
        provenance=Provenance("plan", "csv", {}, {}),
    )
    load = None
    if parameters.wrench_point is not None and np.any(schedule.wrench):
        load = Load(schedule.wrench[:, :3].T, schedule.wrench[:, 3:].T, parameters.wrench_point, None)
    space = operating_space(chain_of(cell).corrected(parameters.geometry), parameters, readings, load)
    tracker = None if cell.frames.tracker is None else parameters.tracker[:3, 3]
    return dataclasses.replace(space, tracker=tracker, boxes=_corners(cell))


def _corners(cell: Cell) -> Float3D | None:
    """Return the corners of the cell's boxes, (b, 8, 3) m, base frame; None without boxes."""
    if not cell.boxes:
        return None
    unit = np.array([(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    poses = [pose_matrix(np.array(box.xyz), np.array(box.rpy)) for box in cell.boxes]
    return np.stack(
        [unit * box.size @ pose[:3, :3].T + pose[:3, 3] for box, pose in zip(cell.boxes, poses, strict=True)]
    )


def planned_space(plan: Plan, cell: Cell) -> OperatingSpace:
    """Return where the points of a plan's configurations lie, spares included, as the cell file has it, unloaded."""
    schedule = Schedule.of(plan.configurations)
    unloaded = dataclasses.replace(schedule, wrench=np.zeros_like(schedule.wrench))
    return scheduled_space(unloaded, cell, nominal_parameters(cell))
