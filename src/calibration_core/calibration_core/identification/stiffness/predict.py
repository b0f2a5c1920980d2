"""Predicted readings of an identified model, in the tracker frame."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import ModelFileError, RecordingError
from calibration_core.model.effects.applied import applied_shift
from calibration_core.model.effects.state import recorded_state
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.observations.kinds import references_alone
from calibration_core.timeseries import Bool1D, Float2D, Readings


def predict_readings(readings: Readings, cell: Cell, model: ModelParameters) -> Float2D:
    """Predict where the tracker sees every reading's point, from encoder angles and wrench alone.

    Nothing is fitted.  For displacement recordings the difference to step 0 of the configuration and point is returned,
    as recorded.

    Returns:
        (m, 3) m, tracker frame.

    Raises:
        RecordingError: The recording has a point that the model does not know.
        EquilibriumError: The load is beyond what the joints can carry.
        ModelFileError: The model contains an effect that this recording has no data for.
    """
    require_points(readings, model)
    chain = chain_of(cell).corrected(model.geometry)
    load = None if readings.wrench is None else load_of(readings, cell, model)
    rest = solve_equilibrium(chain, readings.q, model.compliance, load)
    points = np.stack([model.points[name] for name in readings.points])[readings.point].T
    moved = rest.at.point(points).T + shift_by_effects(readings, cell, model)
    predicted = (moved - model.tracker[:3, 3]) @ model.tracker[:3, :3]
    return predicted if cell.measurements.points == "absolute" else from_step_zero(readings, predicted)


def require_points(readings: Readings, model: ModelParameters) -> None:
    """Refuse a recording with a point that the model does not know.

    Raises:
        RecordingError: There is one.
    """
    unknown = [name for name in readings.points if name not in model.points]
    if unknown:
        known = ", ".join(model.points)
        raise RecordingError(readings.provenance.path, "point", repr(unknown[0]), f"a point of the model: {known}")


def shift_by_effects(readings: Readings, cell: Cell, model: ModelParameters) -> Float2D:
    """Return the (m, 3) m, base axes, that the model's effects move the points.

    Raises:
        EquilibriumError: The load is beyond what the joints can carry.
        ModelFileError: The model contains an effect that this recording has no data for.
    """
    if not model.effects:
        return np.zeros((len(readings), 3))
    chain = chain_of(cell).corrected(model.geometry)
    load = None if readings.wrench is None else load_of(readings, cell, model)
    state = recorded_state(readings, cell, chain, model, load)
    try:
        return applied_shift(model.effects, state)
    except ValueError as error:
        raise ModelFileError(readings.provenance.path, "effects", str(error), "data that its effects need") from None


def from_step_zero(readings: Readings, values: Float2D) -> Float2D:
    """Return (m, 3) values less those of the first step of the same configuration and point."""
    keys = np.column_stack([readings.configuration, readings.point])
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.reshape(-1)
    order = np.lexsort((readings.step, group))
    _, starts = np.unique(group[order], return_index=True)
    return values - values[order[starts]][group]


def require_differences(readings: Readings, cell: Cell) -> None:
    """Refuse displacements none of which is more than the reference of its configuration and point.

    Raises:
        IdentificationError: No reading is left that shows anything.
    """
    if cell.measurements.points == "displacement" and references(readings).all():
        raise references_alone(readings)


def references(readings: Readings) -> Bool1D:
    """Return (m,) which rows are the first step of their configuration and point."""
    return from_step_zero(readings, readings.step[:, None].astype(float))[:, 0] == 0
