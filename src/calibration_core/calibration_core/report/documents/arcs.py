"""What the planned arcs are worth: said before the day in the cell (CWA 17384, 7.1)."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.circle_point.joint_axes import single_joint_sweeps
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import tracker_covariance
from calibration_core.observations.average import coordinate_std
from calibration_core.planning.plans.plan import Plan
from calibration_core.report.arcs import describe_arc
from calibration_core.timeseries import Float2D


def describe_arcs(plan: Plan, cell: Cell) -> tuple[str, ...]:
    """Return one sentence per planned sweep of a single joint: its arc, and how well it fixes a circle's centre."""
    if not plan.preparation:
        return ()
    q = np.stack([configuration.q for configuration in plan.preparation])
    lines = []
    for sweep in single_joint_sweeps(q, np.zeros(len(q), dtype=np.int64)):
        joint, rows = sweep.joints[0], q[sweep.rows]
        arc = float(np.ptp(rows[:, joint]))
        lines.append(f"{plan.joints[joint]}: {describe_arc(arc, _sigma(rows, cell), len(rows), 'standstills')}")
    return tuple(lines)


def _sigma(q: Float2D, cell: Cell) -> float:
    """Return the standard deviation of one coordinate that the tracker claims of the points at these angles, m."""
    model = nominal_parameters(cell)
    at = posture(chain_of(cell), q)
    places = np.concatenate([at.point(point).T for point in model.points.values()])
    seen = (places - model.tracker[:3, 3]) @ model.tracker[:3, :3]
    return coordinate_std(tracker_covariance(cell, seen))
