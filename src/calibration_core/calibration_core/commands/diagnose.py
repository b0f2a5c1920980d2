"""`calibration diagnose`: where simulation and recording differ, which physics is left out, and the extended model."""

from __future__ import annotations

import argparse
import dataclasses

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.common import report_line, tell
from calibration_core.commands.inputs import blocked, look, told, write_refused
from calibration_core.commands.offers import offers_for, proposed_plan
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.finding import Diagnosis
from calibration_core.identification.loaded import Options
from calibration_core.model.given import read_given
from calibration_core.model.model_file import model_text
from calibration_core.observations.observe import observe
from calibration_core.procedure.plan_file import plan_text
from calibration_core.report.diagnosis_result import diagnosis_dict
from calibration_core.report.diagnosis_summary import diagnosis_summary
from calibration_core.report.output import RESULT, Content, write_files
from calibration_core.report.result import result_json
from calibration_core.report.tables import table_files


def run(arguments: argparse.Namespace) -> str:
    """Diagnose, write result, tables, extended model and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
    """
    tell(arguments, 0.0, "reading the recording")
    cell = load_cell(arguments.cell)
    readings = observe(arguments.recording, cell)
    test = None if arguments.test is None else observe(arguments.test, cell)
    simulation = None if arguments.simulation is None else observe(arguments.simulation, cell)
    given = None if arguments.model is None else read_given(arguments.model, cell)
    wrong = look(readings, test, cell)
    if blocked(wrong):
        return write_refused(arguments, cell, readings, wrong)
    options = Options(robust=not arguments.no_robust)
    tell(arguments, 1 / 3, "looking for what is left out")
    found = diagnose(readings, cell, options, test, simulation, offers_for(readings, cell), given)
    found = dataclasses.replace(found, anomalies=(*found.anomalies, *told(wrong)))
    tell(arguments, 2 / 3, "drawing the report" if arguments.report else "writing the results")
    result = result_json(diagnosis_dict(found, cell))
    model = found.identification.model if found.model is None else found.model
    files: dict[str, Content] = {RESULT: result, "model.yaml": model_text(model, cell).encode()}
    if found.next_measurements:
        files["next.yaml"] = plan_text(proposed_plan(found.next_measurements, cell)).encode()
    files |= table_files(dataclasses.replace(found.identification, model=model), cell.prismatic)
    if arguments.report:
        files |= _report(found, cell, result)
    write_files(arguments.out, files)
    return f"{diagnosis_summary(found)}\n{report_line(arguments)}"


def _report(found: Diagnosis, cell: Cell, result: bytes) -> dict[str, Content]:
    from calibration_core.commands.diagnose_document import diagnosis_document
    from calibration_core.report.rendering import rendered

    return rendered(diagnosis_document(found, cell, result), found.identification.space)
