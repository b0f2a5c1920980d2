"""`calibration predict`: where an identified model puts the points of a recording."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.identification.identify import is_loaded
from calibration_core.model.identified.given import read_given
from calibration_core.observations.observe import observe
from calibration_core.outcomes.inputs import refuse_lengths
from calibration_core.outcomes.prediction import Prediction, predict
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.result import recording_record, result_json
from calibration_core.report.rounding import counted
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.report.writing.tables import PREDICTIONS, predictions_csv


def run(arguments: argparse.Namespace) -> str:
    """Predict every reading from angles and wrenches alone, write the comparison, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    report_progress(arguments, 0.0, "predicting the readings")
    cell = load_cell(arguments.cell)
    refuse_lengths(cell)
    given = read_given(arguments.model, cell)
    found = predict(cell, given, observe(arguments.recording, cell))
    report_progress(arguments, 0.5, "drawing the report" if arguments.report else "writing the results")
    write_files(arguments.out, files_of(found, cell, report=arguments.report))
    return f"{prediction_summary(found)}\npredictions: {arguments.out / PREDICTIONS}\n{report_line(arguments)}"


def files_of(found: Prediction, cell: Cell, *, report: bool) -> dict[str, Content]:
    """Return all files of a prediction: file name -> content."""
    result = result_json(prediction_result(found, cell))
    files: dict[str, Content] = {RESULT: result, PREDICTIONS: predictions_csv(found.readings, found.predicted)}
    if not report:
        return files
    from calibration_core.report.documents.prediction import prediction_document
    from calibration_core.report.view3d.space import space_view
    from calibration_core.report.writing.rendering import rendered

    return {**files, **rendered(prediction_document(found, cell, result), space_view(found.space, cell))}


def prediction_result(found: Prediction, cell: Cell) -> dict[str, Any]:
    """Return the content of result.json; `rms_after` is the model's, `rms_before` the cell file's."""
    readings = found.readings
    fit = {"rms_after": found.error.rms, "noise": float(np.sqrt(np.mean(found.residuals.sigma**2)))}
    if found.before is not None:
        fit["rms_before"] = found.before.rms
    return command_result(
        "predict",
        cell,
        recording_record(readings, loaded=is_loaded(readings)),
        {**fit, "mean_after": found.error.mean, "max_after": found.error.maximum},
        predictions=PREDICTIONS,
        deflection=None
        if found.deflection is None
        else {"after": vars(found.deflection[0]), "before": vars(found.deflection[1]), "unit": "m"},
        notes=[vars(note) for note in readings.notes],
        input=input_record(cell, readings.provenance, found.inputs),
    )


def prediction_summary(found: Prediction) -> str:
    """Return what came out, in a few lines."""
    error, before = found.error, found.before
    cell_file = "" if before is None else f" (cell file: mean {1e3 * before.mean:.3f} mm)"
    lines = [
        (
            f"{counted(len(found.readings), 'reading')}: error mean {1e3 * error.mean:.3f} mm, "
            f"largest {1e3 * error.maximum:.3f} mm{cell_file}"
        )
    ]
    if found.deflection is not None and found.kind == "absolute":
        after, nominal = found.deflection
        lines.append(
            f"deflection: error mean {1e3 * after.mean:.3f} mm, largest {1e3 * after.maximum:.3f} mm "
            f"(cell file: mean {1e3 * nominal.mean:.3f} mm)"
        )
    return "\n".join(lines)
