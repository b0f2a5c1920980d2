"""What a recording covers: joints, loads, temperature."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.identified.calibrated import ValidRange
from calibration_core.model.kinematics import cross, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.recorded_load import recorded_load
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float2D, Readings


def range_of(readings: Readings, cell: Cell, parameters: ModelParameters) -> ValidRange:
    """Return what a recording covers.

    Args:
        readings: The recording.
        cell: How its wrenches are recorded.
        parameters: Where sensor and wrench point sit.

    Raises:
        CellError: The robot cannot be read, or a frame that the wrench needs is missing.
    """
    known = readings.temperature[np.isfinite(readings.temperature)]
    sizes = np.zeros((2, 1)) if readings.wrench is None else _sizes(readings, cell, parameters)
    return ValidRange(
        joints=np.column_stack([readings.q.min(axis=0), readings.q.max(axis=0)]),
        force=(float(sizes[0].min()), float(sizes[0].max())),
        torque=(float(sizes[1].min()), float(sizes[1].max())),
        temperature=(float(known.min()), float(known.max())) if len(known) else None,
    )


def _sizes(readings: Readings, cell: Cell, parameters: ModelParameters) -> Float2D:
    """Return the sizes (2, m) of force, N, and of torque about the wrench point, N*m."""
    assert readings.wrench is not None  # noqa: S101 - asked for only where one was recorded
    at = posture(chain_of(cell).corrected(parameters.geometry), readings.q)
    force, torque, where = recorded_load(readings.wrench, cell, parameters).in_base(at)
    if parameters.wrench_point is not None:
        torque = torque + cross(where - at.point(parameters.wrench_point), force)
    return np.stack([np.linalg.norm(force, axis=0), np.linalg.norm(torque, axis=0)])
