"""A model against places that it was not identified from: errors, their uncertainty, and the decision."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from calibration_core.acceptance.decision import Decision, decide, overall
from calibration_core.acceptance.prediction_covariance import (
    by_wrench,
    model_columns,
    only_positions_off,
    propagated,
    repeatability,
)
from calibration_core.cell import Cell
from calibration_core.errors import RecordingError
from calibration_core.identification.stiffness.predict import predict_readings, references, require_differences
from calibration_core.model.chain import aligned
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.average import position_covariance
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Readings

FEWEST = 3  # places from which a frame is fitted
GEOMETRY = ("geometry", "tracker", "measurement_points", "wrench_point", "force_torque")
Source = Literal["tracker", "wrench", "geometry", "model", "repeatability"]
SOURCES: tuple[Source, ...] = ("tracker", "wrench", "geometry", "model", "repeatability")


@dataclasses.dataclass(frozen=True, eq=False)
class Verification:
    """A recording judged by a model and a tolerance; rows are the readings that count.

    Attributes:
        readings: The m readings that count: reference steps of recorded displacements do not.
        error: (m, 3) m, measured - predicted, tracker frame.
        before: (m, 3) m, the same with the cell file's model; None where it states no tracker pose and none is fitted.
        size: (m,) m, length of the error.
        uncertainty: (m,) m, standard uncertainty of that length.
        shares: Source -> (m,) m, what contributes to it; `geometry` and `model` are correlated, so that they need not
            add up.
        decisions: (m,) one per reading.
        decision: On the whole.
        tolerance: m.
        fitted: Whether the tracker's pose was fitted to this recording.
        elsewhere: Root mean square of the error if it were fitted, m; None where it was, or cannot be.
        outside: (m,) whether the model's valid range ends before this reading.
        with_intervals: Whether the model states a covariance.
        only_positions: Whether the differences under load are within noise and intervals, while the positions are not.
        nominal_geometry: Whether the model's geometry is as the cell file states it.
    """

    readings: Readings
    error: Float2D
    before: Float2D | None
    size: Float1D
    uncertainty: Float1D
    shares: dict[Source, Float1D]
    decisions: tuple[Decision, ...]
    decision: Decision
    tolerance: float
    fitted: bool
    elsewhere: float | None
    outside: Bool1D
    with_intervals: bool
    only_positions: bool
    nominal_geometry: bool

    @property
    def least_certain(self) -> int:
        """Index of the reading with the largest uncertainty, of which the budget is."""
        return int(np.argmax(self.uncertainty))


def verify(
    readings: Readings, cell: Cell, model: CalibratedModel, tolerance: float, *, fit_tracker: bool = False
) -> Verification:
    """Predict a recording, and decide on every reading and on the whole.

    The uncertainty of an error is that of the tracker, of the wrench through the model, of everything identified, and
    of the robot's repeatability, where loads were repeated; it is taken in the direction of the error.

    Args:
        readings: A recording that the model was not identified from.
        cell: The cell.
        model: The identified model.
        tolerance: What the length of an error may not exceed, m.
        fit_tracker: Fit the tracker's pose to this recording first, because it was set up anew.

    Raises:
        IdentificationError: The recording holds displacements, and reference steps alone.
        RecordingError: The recording has a point that the model does not know, or too few places to fit a frame.
        ModelFileError: The model contains an effect that this recording has no data for.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    require_differences(readings, cell)
    displacement = cell.measurements.points == "displacement"
    places = len(np.unique(readings.configuration))
    if fit_tracker and (displacement or places < FEWEST):
        found = "displacements" if displacement else f"{places} configurations"
        raise RecordingError(
            readings.provenance.path, "positions", found, f"absolute positions at {FEWEST} or more, to fit the tracker"
        )
    parameters = model.parameters
    frame = None
    if fit_tracker:
        parameters = with_fitted_tracker(readings, cell, parameters)
        frame = frame_columns(readings)
    error = readings.position - predict_readings(readings, cell, parameters)
    keep = np.ones(len(readings), dtype=bool)
    if displacement:  # the first step of every configuration and point is the reference: zero by definition
        keep = ~references(readings)
    known, columns = model_columns(readings, cell, parameters, model.estimate, frame)
    tracker = position_covariance(readings, cell)
    covariances: dict[Source, Float3D] = {
        "tracker": tracker,
        "wrench": by_wrench(readings, cell, parameters),
        "geometry": propagated(known, columns, lambda group: group in GEOMETRY),
        "model": propagated(known, columns, lambda group: group not in GEOMETRY),
        "repeatability": repeatability(readings, error, tracker),
    }
    both = propagated(known, columns, lambda _: True)
    total = covariances["tracker"] + covariances["wrench"] + covariances["repeatability"] + both
    size = np.linalg.norm(error, axis=1)
    direction = _directions(error, total)
    uncertainty = _along(total, direction)
    shares = {source: _along(covariances[source], direction)[keep] for source in SOURCES}
    decisions = tuple(decide(size[keep], uncertainty[keep], tolerance))
    return Verification(
        readings=readings.select(keep),
        error=error[keep],
        before=_before(readings, cell, keep, fit_tracker=fit_tracker),
        size=size[keep],
        uncertainty=uncertainty[keep],
        shares=shares,
        decisions=decisions,
        decision=overall(decisions),
        tolerance=tolerance,
        fitted=fit_tracker,
        elsewhere=None if fit_tracker or displacement or places < FEWEST else refitted_rms(readings, cell, parameters),
        outside=_outside(readings, model)[keep],
        with_intervals=model.estimate is not None,
        only_positions=not displacement
        and only_positions_off(
            readings, error, total - both, *model_columns(readings, cell, parameters, model.estimate, None)
        ),
        nominal_geometry=not parameters.geometry.any(),
    )


def with_fitted_tracker(readings: Readings, cell: Cell, parameters: ModelParameters) -> ModelParameters:
    """Return the model with the tracker's pose that fits absolute positions best, all weighted alike (Kabsch, 1976)."""
    seen, measured = predict_readings(readings, cell, parameters), readings.position
    centres = seen.mean(axis=0), measured.mean(axis=0)
    turn = aligned(measured, seen)  # from what the model's tracker sees to what was seen
    pose = np.eye(4)
    pose[:3, :3] = parameters.tracker[:3, :3] @ turn.T
    pose[:3, 3] = parameters.tracker[:3, 3] + parameters.tracker[:3, :3] @ centres[0] - pose[:3, :3] @ centres[1]
    return parameters.replace(tracker=pose)


def frame_columns(readings: Readings) -> Float3D:
    """Return (m, 3, 6): how a shift and a turn of all points as the tracker sees them move the predictions."""
    columns = np.zeros((len(readings), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, 3 + k] = np.cross(axis, readings.position)
    return columns


def refitted_rms(readings: Readings, cell: Cell, parameters: ModelParameters) -> float:
    """Return the root mean square per coordinate, m, of the errors with the tracker's pose fitted to the recording."""
    fitted = with_fitted_tracker(readings, cell, parameters)
    return float(np.sqrt(np.mean((readings.position - predict_readings(readings, cell, fitted)) ** 2)))


def _before(readings: Readings, cell: Cell, keep: Bool1D, *, fit_tracker: bool) -> Float2D | None:
    displacement = cell.measurements.points == "displacement"
    if cell.frames.tracker is None and not fit_tracker and not displacement:
        return None
    nominal = nominal_parameters(cell)
    if fit_tracker:
        nominal = with_fitted_tracker(readings, cell, nominal)
    return np.asarray((readings.position - predict_readings(readings, cell, nominal))[keep])


def _directions(error: Float2D, covariance: Float3D) -> Float2D:
    """Return (m, 3) unit vectors along the errors; where an error is within its noise, where it is known least."""
    size = np.linalg.norm(error, axis=1)
    values, vectors = np.linalg.eigh(covariance)
    small = size**2 <= values[:, -1]
    return np.where(small[:, None], vectors[:, :, -1], error / np.where(size > 0, size, 1.0)[:, None])


def _along(covariance: Float3D, direction: Float2D) -> Float1D:
    return np.asarray(np.sqrt(np.maximum(np.einsum("ma,mab,mb->m", direction, covariance, direction), 0.0)))


def _outside(readings: Readings, model: CalibratedModel) -> Bool1D:
    covered = model.valid_range
    if covered is None:
        return np.zeros(len(readings), dtype=bool)
    outside = covered.joint_outside(readings.q).any(axis=1) | covered.temperature_outside(readings.temperature)
    if readings.wrench is not None:
        force = np.linalg.norm(readings.wrench[:, :3], axis=1)
        outside |= covered.load_outside(force, np.zeros(len(force)))
    return np.asarray(outside)
