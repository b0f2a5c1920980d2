"""`calibration export`: the calibrated robot in the format of another program."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Collection
from typing import Any

from calibration_core.cell import Cell, load_cell
from calibration_core.engine.command_line import refuse_without_effect, separate
from calibration_core.errors import CalibrationError, InputError, quoted
from calibration_core.files.written import json_bytes
from calibration_core.formats.calibrated import Exported, ExportedRobot, calibrated_robot, named
from calibration_core.formats.dh import dh_files
from calibration_core.formats.mjcf import mjcf_files
from calibration_core.formats.table import DeflectionGrid, table_files
from calibration_core.formats.ur import ur_files
from calibration_core.formats.urdf import urdf_files
from calibration_core.model.identified.model_file import read_given
from calibration_core.outcomes.inputs import Inputs, naming_model
from calibration_core.report.results.command import input_record
from calibration_core.report.results.result import SCHEMA
from calibration_core.report.rounding import length_in_words
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.report.writing.ownership import refuse_inputs

WITHOUT_FORMAT = (
    "KUKA's, FANUC's, ABB's and Yaskawa's own calibration files have no published format: correct the targets instead "
    "(calibration compensate)."
)
OF_FORMAT = {"ur": ("--template",), "table": ("--joints", "--points", "--q", "--range")}
"""Format -> the options that have an effect on it alone."""
MOST = {"urdf": 1e-9, "dh": 1e-6, "ur": 1e-6, "mjcf": 1e-9}  # m: what is written may not differ from the model by more


def run(arguments: argparse.Namespace) -> str:
    """Write the model's robot in one format, compare what was written with the model, and return a summary.

    Raises:
        InputError: Cell, model or template cannot be used, the format cannot hold the robot, or nothing can be written.
        EquilibriumError: The robot cannot carry its own weight.
    """
    refuse_idle(arguments.stated, arguments.format)
    cell = load_cell(arguments.cell)
    refuse_inputs(arguments.out, "export", () if cell.urdf_path is None else (cell.urdf_path,))
    with naming_model(arguments.model):
        given = read_given(arguments.model, cell)
        robot = calibrated_robot(cell, given.parameters, given.notes)
        exported = exported_as(robot, arguments)
    write_files(arguments.out, files_of(robot, exported, arguments.format, given.digest))
    where = f"{', '.join(sorted(exported.files))} in {arguments.out}"
    return f"{robot.cell.robot.name} as {arguments.format}: {where}\n{export_summary(robot, exported)}"


def refuse_idle(stated: Collection[str], form: str) -> None:
    """Refuse stated options that have no effect on a format.

    Raises:
        InputError: There is one.
    """
    for other, options in OF_FORMAT.items():
        if other != form:
            refuse_without_effect(stated, "export", options, f"on the format {form}", f"--format {other}")


def exported_as(robot: ExportedRobot, arguments: argparse.Namespace) -> Exported:
    """Return a robot in the format that the options ask for, compared with the model.

    Raises:
        InputError: Template or options cannot be used, or the format cannot hold the robot.
        EquilibriumError: The robot cannot carry its own weight.
        CalibrationError: What was written differs from the model by more than the format's digits do.
    """
    exported = _exported(robot, arguments)
    too_far = [one for one in exported.deviations if one.largest > MOST.get(arguments.format, math.inf)]
    if too_far:
        msg = f"{too_far[0].what} differ by {too_far[0].largest:.3g} m from the model's"
        raise CalibrationError(msg)
    return exported


def files_of(robot: ExportedRobot, exported: Exported, form: str, inputs: Inputs) -> dict[str, Content]:
    """Return everything that the command writes: file name -> content.

    Args:
        robot: The robot.
        exported: It in the format.
        form: The format.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
    """
    return {RESULT: json_bytes(export_result(robot, exported, form, inputs)), **exported.files}


def _exported(robot: ExportedRobot, arguments: argparse.Namespace) -> Exported:
    if arguments.format == "urdf":
        return urdf_files(robot, arguments.out)
    if arguments.format == "dh":
        return dh_files(robot)
    if arguments.format == "ur":
        return ur_files(robot, arguments.template)
    if arguments.format == "mjcf":
        return mjcf_files(robot)
    q, ends = _numbers("--q", arguments.q), _numbers("--range", arguments.range)
    return table_files(robot, DeflectionGrid(tuple(arguments.joints), arguments.points, q, ends))


def _numbers(option: str, text: str | None) -> tuple[float, ...] | None:
    """Return the numbers of a text, with blanks or commas between."""
    if text is None:
        return None
    try:
        return separate(text)
    except ValueError as fault:
        expected = f"numbers with blanks between, rad{fault}"
        raise InputError("export --format table", option, quoted(text), expected) from None


def export_result(robot: ExportedRobot, exported: Exported, form: str, inputs: Inputs) -> dict[str, Any]:
    """Return the content of result.json; arguments as `files_of`."""
    cell: Cell = robot.cell
    return {
        "schema": SCHEMA,
        "command": "export",
        "robot": cell.robot.name,
        "format": form,
        "files": sorted(exported.files),
        "deviations": [{**dataclasses.asdict(one), "unit": "m"} for one in exported.deviations],
        "effects_folded": named(robot.folded),
        "effects_held": named(exported.held),
        "effects_left_out": named(_left(robot, exported)),
        "notes": [*(f"{note.place}: {note.text}" for note in robot.notes), *exported.notes],
        "input": input_record(cell, None, inputs),
        "summary": export_summary(robot, exported).splitlines(),
    }


def _left(robot: ExportedRobot, exported: Exported) -> tuple[Any, ...]:
    return tuple(effect for effect in robot.further if effect not in exported.held)


def export_summary(robot: ExportedRobot, exported: Exported) -> str:
    """Return how far what was written is from the model, what it does not hold, and what its reader must know."""
    lines = []
    for one in exported.deviations:
        size = f"largest {length_in_words(one.largest)}, root mean square {length_in_words(one.rms)}"
        lines.append(f"{one.what}: {size} at {one.postures} postures")
    left = _left(robot, exported)
    if left:
        lines.append(f"not in this format: {'; '.join(named(left))}")
    lines += [note.line for note in robot.notes]
    return "\n".join([*lines, *exported.notes, WITHOUT_FORMAT])
