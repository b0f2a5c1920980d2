"""A model against places that it was not identified from: errors, their uncertainty, and the decision."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np

from calibration_core.acceptance.decision import Decision, decide, overall
from calibration_core.cell import Cell
from calibration_core.errors import RecordingError
from calibration_core.identification.stiffness.predict import predict_readings, references
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import with_values
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.covariance import position_covariance, wrench_covariance
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Readings

FEWEST = 3  # places from which a frame is fitted
SAME_LOAD = 0.02  # of the largest load: steps so near to each other repeat a load
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
        RecordingError: The recording has a point that the model does not know, or too few places to fit a frame.
        ModelFileError: The model contains an effect that this recording has no data for.
        EquilibriumError: A load is beyond what the joints can carry.
    """
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
    known, columns = _model_columns(readings, cell, parameters, model.estimate, frame)
    tracker = position_covariance(readings, cell)
    covariances: dict[Source, Float3D] = {
        "tracker": tracker,
        "wrench": _by_wrench(readings, cell, parameters),
        "geometry": _propagated(known, columns, lambda group: group in GEOMETRY),
        "model": _propagated(known, columns, lambda group: group not in GEOMETRY),
        "repeatability": _repeatability(readings, error, tracker),
    }
    both = _propagated(known, columns, lambda _: True)
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
        elsewhere=None if fit_tracker or displacement or places < FEWEST else _refitted(readings, cell, parameters),
        outside=_outside(readings, model)[keep],
        with_intervals=model.estimate is not None and bool(model.estimate.names),
    )


def with_fitted_tracker(readings: Readings, cell: Cell, parameters: ModelParameters) -> ModelParameters:
    """Return the model with the tracker's pose that fits absolute positions best, all weighted alike (Kabsch, 1976)."""
    seen, measured = predict_readings(readings, cell, parameters), readings.position
    centres = seen.mean(axis=0), measured.mean(axis=0)
    u, _, vt = np.linalg.svd((measured - centres[1]).T @ (seen - centres[0]))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt  # from what the model's tracker sees to what was seen
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


def _refitted(readings: Readings, cell: Cell, parameters: ModelParameters) -> float:
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


def _model_columns(
    readings: Readings,
    cell: Cell,
    parameters: ModelParameters,
    estimate: GaussianEstimate | None,
    frame: Float3D | None,
) -> tuple[GaussianEstimate, Float3D]:
    """Return what is known of the model with limits, and (m, 3, p) how the predictions move with it, per unit.

    Central differences over one standard deviation.  With a frame that is fitted, (m, 3, 6), what a rigid movement of
    all points takes up is taken off.
    """
    m = len(readings)
    std = np.zeros(0) if estimate is None else estimate.std
    known = GaussianEstimate.nothing() if estimate is None else estimate.chosen(
        np.flatnonzero(np.isfinite(std) & (std > 0))
    )  # fmt: skip
    columns = np.zeros((m, 3, len(known.names)))
    for k, (name, value, step) in enumerate(zip(known.names, known.value, known.std, strict=True)):
        ends = [
            predict_readings(readings, cell, with_values(parameters, {name: value + sign * step}))
            for sign in (1.0, -1.0)
        ]
        columns[:, :, k] = (ends[0] - ends[1]) / (2 * step)
    if frame is not None:
        basis, _ = np.linalg.qr(frame.reshape(-1, 6))
        flat = columns.reshape(3 * m, -1)
        columns = (flat - basis @ (basis.T @ flat)).reshape(columns.shape)
    return known, columns


def _propagated(known: GaussianEstimate, columns: Float3D, chosen: Callable[[str], bool]) -> Float3D:
    """Return what is not known of some of the model's numbers, by their group, in the predictions, (m, 3, 3) m^2."""
    rows = [k for k, name in enumerate(known.names) if chosen(name.partition(".")[0])]
    part, covariance = columns[:, :, rows], known.covariance[np.ix_(rows, rows)]
    return np.asarray(part @ covariance @ np.swapaxes(part, 1, 2))


def _by_wrench(readings: Readings, cell: Cell, parameters: ModelParameters) -> Float3D:
    """Return what the noise of the wrench does to the predictions, by central differences."""
    m = len(readings)
    if readings.wrench is None:
        return np.zeros((m, 3, 3))
    covariance = wrench_covariance(readings, cell)
    columns = np.zeros((m, 3, 6))
    for k in range(6):
        step = np.zeros((m, 6))
        step[:, k] = np.sqrt(covariance[:, k, k])
        if not step.any():
            continue
        ends = [
            predict_readings(dataclasses.replace(readings, wrench=readings.wrench + sign * step), cell, parameters)
            for sign in (1.0, -1.0)
        ]
        columns[:, :, k] = (ends[0] - ends[1]) / 2
    scale = np.sqrt(np.einsum("mkk->mk", covariance))
    scale = np.where(scale > 0, scale, 1.0)
    correlation = covariance / (scale[:, :, None] * scale[:, None, :])
    return np.asarray(np.einsum("mak,mkl,mbl->mab", columns, correlation, columns))


def _repeatability(readings: Readings, error: Float2D, tracker: Float3D) -> Float3D:
    """Return the robot's scatter at repeated loads beyond the tracker's, (m, 3, 3) m^2; zeros where none was repeated.

    Repeated are steps of one configuration and point whose wrenches differ by less than 2 % of the largest.
    """
    none = np.zeros((len(readings), 3, 3))
    if readings.wrench is None:
        return none
    largest = np.linalg.norm(readings.wrench[:, :3], axis=1).max(initial=0.0)
    if largest == 0.0:
        return none
    level = np.round(readings.wrench[:, :3] / (SAME_LOAD * largest)).astype(np.int64)
    keys = np.column_stack([readings.configuration, readings.point, level])
    _, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    repeated = count[group] > 1
    freedom = int(np.sum(count[count > 1] - 1))
    if freedom == 0:
        return none
    mean = np.stack([np.bincount(group, weights=error[:, k]) / count for k in range(3)], axis=1)
    scatter = float(np.sum((error - mean[group])[repeated] ** 2)) / (3 * freedom)
    noise = float(np.mean(np.trace(tracker[repeated], axis1=1, axis2=2))) / 3
    return none + max(scatter - noise, 0.0) * np.eye(3)


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
