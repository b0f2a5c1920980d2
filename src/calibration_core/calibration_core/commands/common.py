"""What several commands share: where the results stand, and what a plan's configurations look like in space."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import ModelFileError
from calibration_core.identification.estimate import OperatingSpace
from calibration_core.identification.space import operating_space
from calibration_core.model.chain import pose_matrix
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulate import Schedule
from calibration_core.model.statics import Load
from calibration_core.procedure.plan import Plan
from calibration_core.recording.source import sha256_of
from calibration_core.report.output import REPORT_HTML, REPORT_PDF, RESULT
from calibration_core.timeseries import Float3D, Provenance, Readings


def tell(arguments: argparse.Namespace, share: float, text: str) -> None:
    """Tell who started the command, and wants to know (`arguments.tell`), what it does next.

    Args:
        arguments: Options of the command.
        share: Share of the command's stages that are done, 0 to 1.
        text: What is done next.
    """
    listener: Callable[[float, str], None] | None = getattr(arguments, "tell", None)
    if listener is not None:
        listener(share, text)


@contextlib.contextmanager
def naming_model(model: Path | None) -> Iterator[None]:
    """Let errors about a given model that are raised inside name its file."""
    try:
        yield
    except ModelFileError as error:
        raise ModelFileError(model or error.file, error.place, error.found, error.expected) from None


def report_line(arguments: argparse.Namespace) -> str:
    """Return the last line of a summary: where to look."""
    if not arguments.report:
        return f"result: {arguments.out / RESULT}"
    return f"report: {arguments.out / REPORT_HTML} and {arguments.out / REPORT_PDF}"


def digest_of(path: Path) -> dict[str, str]:
    """Return file name -> SHA-256 of one input file."""
    return {path.name: sha256_of(path)}


def scheduled_space(schedule: Schedule, cell: Cell, parameters: ModelParameters) -> OperatingSpace:
    """Return the operating space of what is to be measured, one entry per configuration at its largest load.

    Args:
        schedule: All steps of all configurations.
        cell: The cell.
        parameters: The model that answers.

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
