"""What the commands share that put a calibrated model to use: model, tool, wrench and payload of the command line."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.compensation.robot import CalibratedRobot
from calibration_core.compensation.task import Task, places, read_task
from calibration_core.engine.command_line import separate
from calibration_core.errors import InputError, quoted
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.model_file import read_calibrated
from calibration_core.report.rounding import counted
from calibration_core.timeseries import Float1D

WRENCH = "six numbers fx fy fz tx ty tz, N and N·m"
FARTHEST = 10.0  # m: no robot carries a centre of gravity so far from its flange
PAYLOAD = f"four numbers: mass (kg, not negative) and centre of gravity (m, flange frame), at most {FARTHEST:g} m away"
LARGEST = 1e6


def numbers(option: str, text: str, count: int, expected: str) -> Float1D:
    """Return the numbers of an option, separated by spaces or commas.

    Raises:
        InputError: There are more or fewer, or one is none.
    """
    try:
        values = np.array(separate(text))
    except ValueError as fault:
        raise InputError(option, "", quoted(text), f"{expected}{fault}") from None
    if len(values) != count or not np.all(np.isfinite(values)) or np.abs(values).max(initial=0.0) > LARGEST:
        raise InputError(option, "", quoted(text), expected)
    return values


def calibrated(arguments: argparse.Namespace) -> tuple[Cell, CalibratedModel, CalibratedRobot]:
    """Return cell, model and robot with its payload.

    Raises:
        InputError: One of the files cannot be used, or the model belongs to another robot.
    """
    cell = load_cell(arguments.cell)
    model = read_calibrated(arguments.model, cell)
    payload = None
    if arguments.payload is not None:
        mass, *centre = (float(x) for x in numbers("--payload", arguments.payload, 4, PAYLOAD))
        if mass < 0 or math.hypot(*centre) > FARTHEST:
            raise InputError("--payload", "", quoted(arguments.payload), PAYLOAD)
        payload = (mass, *centre)
    return cell, model, CalibratedRobot.of(cell, model.parameters, payload)


def task_of(path: Path | None, arguments: argparse.Namespace, cell: Cell) -> Task:
    """Return the task of a file, or of `--q` alone, under `--wrench` where that is given.

    Raises:
        InputError: It cannot be used.
    """
    n = len(cell.robot.joints)
    if path is not None:
        task = read_task(path, cell)
    else:
        angles = numbers("--q", arguments.q, n, f"{n} joint angles, rad (m where a joint slides)")
        task = dataclasses.replace(places(q=angles[None]), source="--q")
    if arguments.wrench is None:
        return task
    return task.with_wrench([float(x) for x in numbers("--wrench", arguments.wrench, 6, WRENCH)], "--wrench")


def finite_or_none(value: float) -> float | None:
    """Return a number that JSON can hold; None for what is not known."""
    return value if math.isfinite(value) else None


def outside_lines(outside: Mapping[str, Sequence[int]]) -> list[str]:
    """Return a line of the summary for everything by which rows lie beyond the model's valid range."""
    return [f"beyond the model's valid range ({key}): {counted(len(rows), 'row')}" for key, rows in outside.items()]
