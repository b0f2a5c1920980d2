"""`calibration predict`: where an identified model puts the points of a recording."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.common import digest_of, naming_model, report_line, tell
from calibration_core.identification.estimate import OperatingSpace, Residuals
from calibration_core.identification.identify import is_loaded
from calibration_core.identification.predict import from_step_zero, predict_readings
from calibration_core.identification.problem import load_of
from calibration_core.identification.space import operating_space
from calibration_core.model.model_file import read_model
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.covariance import position_covariance
from calibration_core.observations.observe import observe
from calibration_core.report.command_result import command_result, input_record
from calibration_core.report.output import RESULT, Content, write_files
from calibration_core.report.result import result_json
from calibration_core.report.rounding import counted
from calibration_core.report.shown import references
from calibration_core.report.tables import PREDICTIONS, predictions_csv
from calibration_core.timeseries import Float2D, Readings


@dataclasses.dataclass(frozen=True)
class ErrorSize:
    """How far predictions are from readings.

    Attributes:
        rms: Per coordinate, m.
        mean: Mean 3-d error, m.
        maximum: Largest 3-d error, m.
    """

    rms: float
    mean: float
    maximum: float

    @staticmethod
    def of(error: Float2D) -> ErrorSize:
        """Return the figures of (m, 3) errors, m."""
        lengths = np.linalg.norm(error, axis=1)
        return ErrorSize(float(np.sqrt(np.mean(error**2))), float(lengths.mean()), float(lengths.max()))


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """A recording beside its prediction.

    Attributes:
        readings: What was measured.
        kind: `loaded` where positions are deflections (differences to step 0), else `absolute`.
        parameters: The identified model.
        predicted: (m, 3) m, tracker frame.
        residuals: The same in base axes; nothing was fitted, so nothing was left out.
        space: The operating space.
        error: Of the positions; where they are differences, reference steps, zero by definition, are not counted.
        before: The same with the cell file's model; None where it states no tracker pose.
        deflection: Error of the differences to step 0, with the model and with the cell file's; None for single steps.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
    """

    readings: Readings
    kind: Literal["loaded", "absolute"]
    parameters: ModelParameters
    predicted: Float2D
    residuals: Residuals
    space: OperatingSpace
    error: ErrorSize
    before: ErrorSize | None
    deflection: tuple[ErrorSize, ErrorSize] | None
    inputs: dict[str, dict[str, str]]

    def shown(self) -> Prediction:
        """Return the same without the reference steps of a recording of differences: their error says nothing."""
        if self.kind == "absolute":
            return self
        keep = ~references(self.readings)
        rows = {field.name: getattr(self.residuals, field.name)[keep] for field in dataclasses.fields(Residuals)}
        return dataclasses.replace(
            self,
            readings=self.readings.select(keep),
            predicted=self.predicted[keep],
            residuals=dataclasses.replace(self.residuals, **rows),
        )


def run(arguments: argparse.Namespace) -> str:
    """Predict every reading from angles and wrenches alone, write the comparison, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    tell(arguments, 0.0, "predicting the readings")
    cell = load_cell(arguments.cell)
    found = predict(cell, arguments.model, observe(arguments.recording, cell))
    result = result_json(prediction_result(found, cell))
    files: dict[str, Content] = {RESULT: result, PREDICTIONS: predictions_csv(found.readings, found.predicted)}
    if arguments.report:
        tell(arguments, 0.5, "drawing the report")
        from calibration_core.commands.predict_document import prediction_document
        from calibration_core.report.rendering import rendered

        files |= rendered(prediction_document(found, cell, result), found.space)
    write_files(arguments.out, files)
    return f"{prediction_summary(found)}\npredictions: {arguments.out / PREDICTIONS}\n{report_line(arguments)}"


def predict(cell: Cell, model: Path, readings: Readings) -> Prediction:
    """Predict a recording with an identified model; nothing is fitted.

    Raises:
        InputError: The model cannot be used, or does not know a point of the recording.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    parameters = read_model(model, cell)
    with naming_model(model):
        predicted = predict_readings(readings, cell, parameters)
    error = readings.position - predicted
    displacement = cell.measurements.points == "displacement"
    counted_rows = ~references(readings) if displacement else np.ones(len(readings), dtype=bool)
    nominal = None
    if displacement or cell.frames.tracker is not None:
        nominal = readings.position - predict_readings(readings, cell, nominal_parameters(cell))
    load = None if readings.wrench is None else load_of(readings, cell, parameters)
    deflection = None
    if is_loaded(readings) and nominal is not None:
        later = ~references(readings)
        after, before = (from_step_zero(readings, one)[later] for one in (error, nominal))
        deflection = ErrorSize.of(after), ErrorSize.of(before)
    return Prediction(
        readings=readings,
        kind="loaded" if displacement else "absolute",
        parameters=parameters,
        predicted=predicted,
        residuals=_residuals(readings, cell, parameters, predicted),
        space=operating_space(chain_of(cell).corrected(parameters.geometry), parameters, readings, load),
        error=ErrorSize.of(error[counted_rows]),
        before=None if nominal is None else ErrorSize.of(nominal[counted_rows]),
        deflection=deflection,
        inputs={"model": digest_of(model)},
    )


def _residuals(readings: Readings, cell: Cell, parameters: ModelParameters, predicted: Float2D) -> Residuals:
    rotation = parameters.tracker[:3, :3]
    origin = parameters.tracker[:3, 3] if cell.measurements.points == "absolute" else np.zeros(3)
    variance = np.einsum("ai,mij,aj->ma", rotation, position_covariance(readings, cell), rotation, optimize=True)
    m = len(readings)
    return Residuals(
        measured=readings.position @ rotation.T + origin,
        predicted=predicted @ rotation.T + origin,
        residual=(readings.position - predicted) @ rotation.T,
        held_out=np.full((m, 3), np.nan),
        sigma=np.sqrt(variance),
        load=np.zeros(m) if readings.wrench is None else np.linalg.norm(readings.wrench[:, :3], axis=1),
        excluded=np.zeros(m, dtype=bool),
    )


def prediction_result(found: Prediction, cell: Cell) -> dict[str, Any]:
    """Return the content of result.json; `rms_after` is the model's, `rms_before` the cell file's."""
    readings = found.readings
    steps = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    fit = {"rms_after": found.error.rms, "noise": float(np.sqrt(np.mean(found.residuals.sigma**2)))}
    if found.before is not None:
        fit["rms_before"] = found.before.rms
    return command_result(
        "predict",
        cell,
        {
            "file": readings.provenance.path,
            "configurations": len(np.unique(readings.configuration)),
            "steps": len(steps),
            "points": list(readings.points),
            "loaded": is_loaded(readings),
            "readings": len(readings),
        },
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
