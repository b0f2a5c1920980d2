"""`calibration predict`: where an identified model puts the points of a recording."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from typing import Any

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.commands.shared.several import dated
from calibration_core.model.identified.model_file import GivenModel, read_given
from calibration_core.observations.kinds import is_loaded
from calibration_core.observations.observe import observe
from calibration_core.outcomes.inputs import blocked, look, refuse_lengths, with_model_note, with_unit_note
from calibration_core.outcomes.prediction import Prediction, only_positions, predict
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.result import recording_record, result_json
from calibration_core.report.results.traffic_light import light_of, with_light
from calibration_core.report.rounding import counted
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.report.writing.tables import PREDICTIONS, predictions_csv
from calibration_core.timeseries import NO_INTERVALS, Readings

WITHIN = "the error is within what noise and the model's intervals allow"


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
    (readings,) = dated([observe(arguments.recording, cell)], arguments.date, "predict")
    answer = evaluate(cell, given, readings)
    report_progress(arguments, 0.5, "drawing the report" if arguments.report else "writing the results")
    write_files(arguments.out, answer.files(report=arguments.report))
    where = f"\npredictions: {arguments.out / PREDICTIONS}" if isinstance(answer, PredictedRecording) else ""
    return f"{answer.summary}{where}\n{report_line(arguments)}"


@dataclasses.dataclass(frozen=True, eq=False)
class PredictedRecording:
    """A prediction as the command answers it.

    Attributes:
        found: Readings, predicted points and errors.
    """

    cell: Cell
    found: Prediction

    @functools.cached_property
    def content(self) -> dict[str, Any]:
        """The content of result.json."""
        return prediction_result(self.found, self.cell)

    @property
    def summary(self) -> str:
        """The traffic light and the errors, mm."""
        return "\n".join(self.content["summary"])

    def files(self, *, report: bool) -> dict[str, Content]:
        """Return all files: file name -> content."""
        return files_of(self.found, self.content, self.cell, report=report)


def evaluate(cell: Cell, given: GivenModel, readings: Readings) -> PredictedRecording | Refusal:
    """Look at the input, predict, and judge the error.

    Raises:
        InputError: The model does not know a point of the recording, or needs data that the recording has not.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    wrong = look(readings, None, cell)
    if blocked(wrong):
        return Refusal.of("predict", cell, readings, wrong, given)
    readings = with_unit_note(readings, cell)
    return PredictedRecording(cell, predict(cell, given, with_model_note(readings, given), wrong))


def files_of(found: Prediction, content: dict[str, Any], cell: Cell, *, report: bool) -> dict[str, Content]:
    """Return all files of a prediction, `content` being that of result.json: file name -> content."""
    result = result_json(content)
    files: dict[str, Content] = {RESULT: result, PREDICTIONS: predictions_csv(found.readings, found.predicted)}
    if not report:
        return files
    from calibration_core.report.documents.prediction import prediction_document
    from calibration_core.report.view3d.space import space_view
    from calibration_core.report.writing.rendering import rendered

    return {
        **files,
        **rendered(prediction_document(found, cell, result, light_of(content)), space_view(found.space, cell)),
    }


def prediction_result(found: Prediction, cell: Cell) -> dict[str, Any]:
    """Return the content of result.json; `rms_after` is the model's, `rms_before` the cell file's."""
    readings = found.readings
    fit = {"rms_after": found.error.rms, "noise": float(np.sqrt(np.mean(found.residuals.sigma**2)))}
    if found.before is not None:
        fit["rms_before"] = found.before.rms
    check = found.check
    content = command_result(
        "predict",
        cell,
        recording_record(readings, loaded=is_loaded(readings)),
        {**fit, "mean_after": found.error.mean, "max_after": found.error.maximum},
        [anomaly.record() for anomaly in (*check.anomalies, *found.noted)],
        verdict="consistent" if check.consistent else "unexplained",
        unexplained={"rms": check.excess, "significant": not check.consistent, "where": {}},
        uncertainty={
            "standard": check.expected,
            "ratio": check.ratio,
            "of": "one coordinate of the error",
            "unit": "m",
        },
        intervals_of_the_model=check.with_intervals,
        predictions=PREDICTIONS,
        deflection=None
        if found.deflection is None
        else {"after": vars(found.deflection[0]), "before": vars(found.deflection[1]), "unit": "m"},
        notes=[vars(note) for note in readings.notes],
        input=input_record(cell, readings.provenance, found.inputs),
    )
    content = with_light(content, WITHIN, _beyond(found))
    return {**content, "summary": [*light_of(content).lines, *prediction_summary(found).splitlines()]}


def _beyond(found: Prediction) -> tuple[str, str]:
    """Return what an error beyond noise and intervals means, and what to do then."""
    check = found.check
    allowed = "noise and the model's intervals allow" if check.with_intervals else "the noise allows"
    text = f"the error is {check.ratio:.2g} times what {allowed}"
    if not check.with_intervals:
        text += ", and the model states no intervals"
    if check.only_positions:
        meaning, step = only_positions(nominal=not found.parameters.geometry.any())
        return f"{meaning}; {text}", step
    return text, "run diagnose with this recording and the model, to see what the model leaves out of it"


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
    lines += [note.line for note in found.readings.notes if note.kind == NO_INTERVALS]
    if found.deflection is not None and found.kind == "absolute":
        after, nominal = found.deflection
        lines.append(
            f"deflection: error mean {1e3 * after.mean:.3f} mm, largest {1e3 * after.maximum:.3f} mm "
            f"(cell file: mean {1e3 * nominal.mean:.3f} mm)"
        )
    return "\n".join(lines)
