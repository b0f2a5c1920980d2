"""A recording beside the prediction of an identified model."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.checks.space import operating_space
from calibration_core.identification.result.estimate import OperatingSpace, Residuals
from calibration_core.identification.stiffness.predict import (
    from_step_zero,
    predict_readings,
    references,
    require_differences,
)
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.model.identified.given import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.recorded_load import load_of
from calibration_core.model.robot import chain_of
from calibration_core.observations.covariance import position_covariance
from calibration_core.observations.kinds import is_loaded
from calibration_core.outcomes.inputs import naming_model, refuse_lengths
from calibration_core.outcomes.prediction_check import PredictionCheck, check_prediction
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
        deflection: Error of the differences to step 0, with the model and with the cell file's; None for single steps,
            and where no point was read at two steps of a configuration.
        check: The error beside what noise and the model's intervals allow.
        noted: What else is wrong with the input and does not forbid a prediction.
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
    check: PredictionCheck
    noted: tuple[InputAnomaly, ...]
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


def predict(cell: Cell, given: GivenModel, readings: Readings, noted: tuple[InputAnomaly, ...] = ()) -> Prediction:
    """Predict a recording with an identified model; nothing is fitted.

    Raises:
        InputError: The model does not know a point of the recording, or needs data that the recording has not; or the
            recording holds reference steps alone.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    refuse_lengths(cell)
    require_differences(readings, cell)
    parameters = given.parameters
    with naming_model(Path(given.file)):
        predicted = predict_readings(readings, cell, parameters)
        check = check_prediction(readings, cell, given.calibrated)
    error = readings.position - predicted
    displacement = cell.measurements.points == "displacement"
    later = ~references(readings)
    counted_rows = later if displacement else np.ones(len(readings), dtype=bool)
    nominal = None
    if displacement or cell.frames.tracker is not None:
        nominal = readings.position - predict_readings(readings, cell, nominal_parameters(cell))
    load = None if readings.wrench is None else load_of(readings, cell, parameters)
    deflection = None
    if is_loaded(readings) and later.any() and nominal is not None:
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
        check=check,
        noted=noted,
        inputs=given.digest,
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
