"""`calibration identify`: joint stiffness, and where the recording allows, frames, geometry and points."""

from __future__ import annotations

import argparse
import dataclasses

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.common import report_line, tell
from calibration_core.commands.inputs import blocked, look, told, write_refused
from calibration_core.errors import InputError, quoted
from calibration_core.identification.identify import identify
from calibration_core.identification.loaded import Options
from calibration_core.identification.robust import Key
from calibration_core.model.given import read_given
from calibration_core.model.model_file import model_text
from calibration_core.observations.observe import observe
from calibration_core.report.summary import summary
from calibration_core.report.writing import write_identification


def run(arguments: argparse.Namespace) -> str:
    """Identify, write result, tables, model and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
    """
    tell(arguments, 0.0, "reading the recording")
    cell = load_cell(arguments.cell)
    readings = observe(arguments.recording, cell)
    test = None if arguments.test is None else observe(arguments.test, cell)
    given = None if arguments.model is None else read_given(arguments.model, cell)
    wrong = look(readings, test, cell)
    if blocked(wrong):
        return write_refused(arguments, cell, readings, wrong)
    options = Options(
        method=arguments.method,
        weights=arguments.weights,
        deflections=arguments.deflections,
        robust=not arguments.no_robust,
        readmit=frozenset(_reading(text, cell) for text in arguments.readmit),
    )
    tell(arguments, 1 / 3, "identifying")
    found = identify(readings, cell, options, test, given)
    found = dataclasses.replace(found, anomalies=(*found.anomalies, *told(wrong)))
    tell(arguments, 2 / 3, "drawing the report" if arguments.report else "writing the results")
    model = {"model.yaml": model_text(found.model, cell).encode()}
    write_identification(found, cell, arguments.out, model, report=arguments.report)
    return f"{summary(found)}\n{report_line(arguments)}"


def _reading(text: str, cell: Cell) -> Key:
    parts = text.split(":", 2)
    try:
        key = int(parts[0]), int(parts[1]), parts[2]
    except (ValueError, IndexError):
        raise InputError("--readmit", "", quoted(text), "CONFIGURATION:STEP:POINT, for example 3:1:mp1") from None
    if key[2] not in cell.points:
        raise InputError("--readmit", "", quoted(text), f"a point of the cell: {', '.join(cell.points)}")
    return key
