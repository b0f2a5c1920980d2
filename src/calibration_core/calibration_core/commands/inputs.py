"""The look at the input that every fitting command takes before any physics."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence

from calibration_core.cell import Cell
from calibration_core.commands.common import digest_of, report_line
from calibration_core.identification.estimate import Anomaly
from calibration_core.identification.space import operating_space
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.input_checks.check import check_inputs
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.report.output import RESULT, Content, write_files
from calibration_core.report.refused import refused_document, refused_result, refused_summary
from calibration_core.report.result import result_json
from calibration_core.timeseries import Readings


def look(readings: Readings, test: Readings | None, cell: Cell) -> tuple[InputAnomaly, ...]:
    """Return what is wrong with the recording and with the one that it is tested on.

    Raises:
        CellError: The robot cannot be read.
    """
    found = check_inputs(readings, cell)
    of_test = () if test is None else check_inputs(test, cell)
    return (*found, *(dataclasses.replace(one, text=f"in the test recording: {one.text}") for one in of_test))


def blocked(found: Sequence[InputAnomaly]) -> bool:
    """Say whether nothing may be claimed."""
    return any(one.blocks for one in found)


def told(found: Sequence[InputAnomaly]) -> tuple[Anomaly, ...]:
    """Return what does not block as anomalies of the answer."""
    return tuple(
        Anomaly(one.kind, {"tracker": "tracker"}, None, one.magnitude, one.unit, one.text, one.remedy)
        for one in found
        if not one.blocks
    )


def write_refused(arguments: argparse.Namespace, cell: Cell, readings: Readings, found: Sequence[InputAnomaly]) -> str:
    """Write result and report of input that cannot be used, and return a summary.

    Raises:
        OutputError: They cannot be written.
    """
    worst = [one for one in found if one.blocks]
    inputs = {"model": digest_of(arguments.model)} if arguments.model is not None else {}
    result = result_json(refused_result(arguments.command, cell, readings, worst, inputs))
    files: dict[str, Content] = {RESULT: result}
    if arguments.report:
        from calibration_core.report.rendering import rendered

        space = operating_space(chain_of(cell), nominal_parameters(cell), readings, None)
        files |= rendered(refused_document(cell, readings, worst, result, inputs), space)
    write_files(arguments.out, files)
    return f"{refused_summary(worst)}\n{report_line(arguments)}"
