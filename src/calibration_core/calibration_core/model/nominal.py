"""What the cell file believes, as model parameters."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import pose_matrix
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D


def nominal_parameters(cell: Cell) -> ModelParameters:
    """Return the cell file's values; no stiffness means rigid joints, no tracker pose the identity."""
    frames, stiffness = cell.frames, cell.robot.stiffness
    n = len(cell.robot.joints)
    tracker, sensor = frames.tracker, frames.force_torque
    return ModelParameters(
        joints=cell.robot.joints,
        compliance=np.zeros(n) if stiffness is None else 1.0 / np.array(stiffness),
        geometry=np.zeros((n, 6)),
        tracker=np.eye(4) if tracker is None else pose_matrix(np.array(tracker.xyz), np.array(tracker.rpy)),
        points={name: np.array(point) for name, point in frames.measurement_points.items()},
        wrench_point=None if frames.wrench_point is None else np.array(frames.wrench_point),
        force_torque=None if sensor is None else pose_matrix(np.array(sensor.xyz), np.array(sensor.rpy)),
    )


def tool_point(cell: Cell) -> Float1D | None:
    """Return the tool centre point, (3,) m in the flange frame, where the cell file states a tool of its own."""
    return None if cell.frames.tool is None else np.array(cell.frames.tool.xyz)
