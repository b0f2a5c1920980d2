"""What the planned arcs are worth: said before the day in the cell (CWA 17384, 7.1)."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.arc import arc_for, centre_std
from calibration_core.identification.sweeps import single_joint_sweeps
from calibration_core.model.instruments import tracker_covariance
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.procedure.plan import Plan
from calibration_core.report.rounding import significant
from calibration_core.timeseries import Float2D

WANTED = 1e-4  # m, accuracy of a circle's centre for which the arc is stated
FULL = 2 * np.pi


def arcs_told(plan: Plan, cell: Cell) -> tuple[str, ...]:
    """Return one sentence per planned sweep of a single joint: its arc, and how well it fixes a circle's centre."""
    if not plan.preparation:
        return ()
    q = np.stack([configuration.q for configuration in plan.preparation])
    told = []
    for sweep in single_joint_sweeps(q, np.zeros(len(q), dtype=np.int64)):
        joint, rows = sweep.joints[0], q[sweep.rows]
        arc, sigma = min(float(np.ptp(rows[:, joint])), FULL), _sigma(rows, cell)
        worth, needed = centre_std(arc, sigma, len(rows)), arc_for(WANTED, sigma, len(rows))
        text = (
            f"{plan.joints[joint]}: {np.degrees(arc):.0f} degrees in {len(rows)} standstills fix a circle's centre to "
            f"{significant(1e6 * worth)} µm along the middle of the arc"
        )
        if needed is not None:
            text += f" (for {1e6 * WANTED:.0f} µm {np.degrees(needed):.0f} degrees are enough)"
        told.append(text)
    return tuple(told)


def _sigma(q: Float2D, cell: Cell) -> float:
    """Return the standard deviation of one coordinate that the tracker claims of the points at these angles, m."""
    model = nominal_parameters(cell)
    at = posture(chain_of(cell), q)
    places = np.concatenate([at.point(point).T for point in model.points.values()])
    seen = (places - model.tracker[:3, 3]) @ model.tracker[:3, :3]
    return float(np.sqrt(np.einsum("mii->m", tracker_covariance(cell, seen)).mean() / 3))
