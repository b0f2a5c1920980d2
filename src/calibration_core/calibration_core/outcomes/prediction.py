"""A recording beside the prediction of an identified model."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np

from calibration_core.acceptance.prediction_covariance import (
    by_wrench,
    less_offsets,
    model_columns,
    only_positions_off,
    propagated,
    repeatability,
    weighted_square,
)
from calibration_core.acceptance.verification import FEWEST, refitted_rms
from calibration_core.cell import Cell
from calibration_core.identification.checks.space import operating_space
from calibration_core.identification.result.estimate import OperatingSpace, Residuals
from calibration_core.identification.statistics import beyond_noise
from calibration_core.identification.stiffness.predict import (
    from_step_zero,
    predict_readings,
    references,
    require_differences,
)
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.input_checks.check import some_of
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.observations.kinds import is_loaded
from calibration_core.outcomes.inputs import naming_model, refuse_lengths
from calibration_core.timeseries import Float2D, Float3D, Readings

FAR = 3.0  # times: so much smaller is the error with another pose of the tracker, or with the cell file's model
VISIBLE = 3.0  # times the noise: less motion under load tells nothing of a model


@dataclasses.dataclass(frozen=True)
class PredictionCheck:
    """The error of a prediction beside what noise and the model's intervals allow.

    Attributes:
        expected: Standard uncertainty of one coordinate of the error, m rms: instruments, repeatability and model.
        ratio: Root mean square of the errors over their uncertainty; about 1 where the model holds.
        excess: By how much the error exceeds what is expected, m rms per coordinate.
        consistent: Whether that is within chance, by the test of `identify`.
        with_intervals: Whether the model states a covariance.
        anomalies: What a larger error shows: another place of the tracker, or a model of another robot.
        only_positions: Whether the deflections are within chance all the same: geometry or frames are not known.
    """

    expected: float
    ratio: float
    excess: float
    consistent: bool
    with_intervals: bool
    anomalies: tuple[InputAnomaly, ...]
    only_positions: bool = False


def only_positions(*, nominal: bool) -> tuple[str, str]:
    """Return what it means that deflections agree and positions do not, and what to do then."""
    text = "the deflections under load agree within noise and intervals, the positions do not: "
    measure = "measure postures without load (calibration plan --for geometry)"
    if nominal:
        step = f"use the model for deflections; for positions {measure}, and identify both recordings together"
        return f"{text}the model's geometry is nominal", step
    return f"{text}its geometry or frames do not hold here", f"for positions {measure}, and identify the robot anew"


def check_prediction(readings: Readings, cell: Cell, model: CalibratedModel) -> PredictionCheck:
    """Judge the error of a prediction; of a long recording, by configurations evenly taken from it.

    Raises:
        RecordingError: The recording has a point that the model does not know.
        ModelFileError: The model contains an effect that this recording has no data for.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    readings = some_of(readings)
    parameters = model.parameters
    displacement = cell.measurements.points == "displacement"
    error = readings.position - predict_readings(readings, cell, parameters)
    tracker = position_covariance(readings, cell)
    noise = tracker + by_wrench(readings, cell, parameters) + repeatability(readings, error, tracker)
    known, columns = model_columns(readings, cell, parameters, model.estimate, None)
    total = noise + propagated(known, columns, lambda _: True)
    freedom, place = 3 * len(readings), not displacement and only_positions_off(readings, error, noise, known, columns)
    if displacement:  # differences share the noise of their first step: every group has a free offset
        error, columns, groups = less_offsets(readings, error, columns)
        freedom -= 3 * groups
    expected = coordinate_std(total)
    ratio = float(np.sqrt(weighted_square(error, noise, known, columns) / max(freedom, 1)))
    excess, beyond = beyond_noise(ratio, freedom, 1.0)
    return PredictionCheck(
        expected=expected,
        ratio=ratio,
        excess=excess * expected if beyond else 0.0,
        consistent=not beyond,
        with_intervals=bool(known.names),
        anomalies=_shown(readings, cell, parameters, error, tracker) if beyond else (),
        only_positions=beyond and place,
    )


def _shown(
    readings: Readings, cell: Cell, parameters: ModelParameters, error: Float2D, tracker: Float3D
) -> tuple[InputAnomaly, ...]:
    """Return what an error shows that noise and intervals do not allow; empty where only physics may be missing."""
    later = ~references(readings)
    if readings.wrench is not None and later.any():
        left, moved = (_rms(from_step_zero(readings, one)[later]) for one in (error, readings.position))
        if moved > VISIBLE * np.sqrt(2.0) * coordinate_std(tracker) and left >= moved:
            text = f"the model explains nothing of the motion under load: {1e3 * left:.3g} mm are left of "
            text += f"{1e3 * moved:.3g} mm (rms per coordinate)"
            remedy = "use the model of this robot, and check that recording and cell file belong to it"
            return (InputAnomaly("no_relation", text, remedy, left, unit="m"),)
    if cell.measurements.points == "displacement" or len(np.unique(readings.configuration)) < FEWEST:
        return ()
    rms, fitted = _rms(error), refitted_rms(readings, cell, parameters)
    nominal = refitted_rms(readings, cell, nominal_parameters(cell))
    if fitted > FAR * nominal:
        text = f"the model puts the points {1e3 * fitted:.3g} mm from where they are (rms per coordinate, with the "
        text += f"tracker's pose fitted), the cell file puts them {1e3 * nominal:.3g} mm from there"
        return (InputAnomaly("wrong_robot_file", text, "use the model of this robot", fitted, unit="m"),)
    if rms > FAR * fitted:
        text = f"the points are {1e3 * rms:.3g} mm from where the model puts them (rms per coordinate), with the "
        text += f"tracker's pose fitted to this recording {1e3 * fitted:.3g} mm: the tracker was set up anew"
        remedy = "use verify with --fit-tracker, or a model that was identified with this set-up"
        return (InputAnomaly("tracker_moved", text, remedy, rms, unit="m"),)
    return ()


def _rms(error: Float2D) -> float:
    return float(np.sqrt(np.mean(error**2)))


# --- A recording beside the prediction of an identified model ---------------------------------------------------------


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
        kind: `loaded` where positions are deflections (differences to step 0), else `absolute`.
        predicted: (m, 3) m, tracker frame.
        residuals: The same in base axes; nothing was fitted, so nothing was left out.
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
