"""What the cell file claims about one averaged reading of each instrument."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.observations.covariance import spherical_covariance
from calibration_core.timeseries import Float1D, Float2D, Float3D


def tracker_covariance(cell: Cell, position: Float2D) -> Float3D:
    """Return the covariance of tracker readings at positions (m, 3) m, tracker frame: (m, 3, 3) m^2, tracker axes."""
    tracker = cell.instruments.tracker
    if tracker.sigma is not None:
        return np.tile(np.eye(3) * tracker.sigma**2, (len(position), 1, 1))
    return spherical_covariance(position, tracker)


def wrench_sigma(cell: Cell) -> Float1D:
    """Return the standard deviations (6,) of one wrench reading, N and N*m; zeros without a claim."""
    claim = cell.instruments.force_torque
    return np.zeros(6) if claim is None else np.repeat([claim.sigma_force, claim.sigma_torque], 3)
