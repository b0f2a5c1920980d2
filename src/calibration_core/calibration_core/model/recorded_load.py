"""The external load behind a recorded wrench: axes and point of reference as the cell file states them."""

from __future__ import annotations

from calibration_core.cell import Cell
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.statics import Load
from calibration_core.timeseries import Float2D, Readings


def recorded_load(wrench: Float2D, cell: Cell, parameters: ModelParameters) -> Load:
    """Return the external load of every reading.

    Args:
        wrench: (m, 6) N and N*m, as recorded.
        cell: How wrenches are recorded.
        parameters: Where sensor and wrench point sit.

    Raises:
        CellError: The pose of the sensor or the wrench point is needed and missing.
    """
    convention = cell.measurements
    sensor = parameters.force_torque
    if sensor is None and (convention.wrench_axes == "sensor" or convention.wrench_at == "sensor"):
        raise cell.missing(
            "frames.force_torque", "a wrench recorded by the sensor (measurements.wrench_axes, wrench_at)"
        )
    if parameters.wrench_point is None and convention.wrench_at == "wrench_point":
        raise cell.missing("frames.wrench_point", "a wrench recorded at the wrench point")
    if convention.wrench_at == "sensor":
        assert sensor is not None  # noqa: S101 - checked above
        point = sensor[:3, 3]
    else:
        assert parameters.wrench_point is not None  # noqa: S101 - checked above
        point = parameters.wrench_point
    rotation = sensor[:3, :3] if sensor is not None and convention.wrench_axes == "sensor" else None
    return Load(wrench[:, :3].T, wrench[:, 3:].T, point, rotation)


def load_of(readings: Readings, cell: Cell, parameters: ModelParameters) -> Load:
    """Return the external load of every reading, as the cell file says that it was recorded.

    Raises:
        CellError: The pose of the sensor or the wrench point is needed and missing.
    """
    if readings.wrench is None:
        raise cell.missing("the recording's wrench", "joint stiffness from a loaded recording")
    return recorded_load(readings.wrench, cell, parameters)
