"""Full pose instead of points: three or more points of a step make one rigid displacement of the tool.

Equation (6) of the standard then has six rows per step: three translations of the centroid and three rotations.
"""

from __future__ import annotations

import numpy as np

from calibration_core.errors import IdentificationError
from calibration_core.identification.statistics.offsets import Rows
from calibration_core.identification.stiffness.problem import Linearised, LoadedProblem
from calibration_core.timeseries import Float2D, Float3D

MIN_SPREAD = 1e-3  # m: second singular value of the centred points; below it they lie on one line


def as_poses(problem: LoadedProblem, linear: Linearised, about: Float2D | None = None) -> tuple[Rows, Float2D, Float3D]:
    """Combine the points of every step into a displacement of the tool.

    Args:
        problem: The readings.
        linear: The problem at some compliances.
        about: (m, 3) m, base frame, the same for all readings of a step: the point of the tool whose translation is
            wanted; None: the centroid of the step's points.

    Returns:
        rows: Grouping and 6 x 6 noise of the steps with at least three points that are not collinear.
        residual: (s, 6) translation of that point (m) and rotation (rad), base axes, measured - predicted.
        columns: (s, 6, n) their derivatives by the compliances.

    Raises:
        IdentificationError: No step has three points that are not collinear.
    """
    readings = problem.readings
    steps, owner = np.unique(np.column_stack([problem.configuration, readings.step]), axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    residual, columns, noise, shared, kept = [], [], [], [], []
    for index in range(len(steps)):
        members = np.flatnonzero(owner == index)
        if len(members) < 3:
            continue
        at = linear.predicted[members]
        arms = at - at.mean(axis=0)
        if np.linalg.svd(arms, compute_uv=False)[1] < MIN_SPREAD:
            continue
        if about is not None:
            arms = at - about[members[0]]
        reduce, covariance = _rigid(arms, linear.rows.noise[members])
        residual.append(reduce @ linear.residual[members].reshape(-1))
        columns.append(reduce @ linear.columns[members].reshape(3 * len(members), -1))
        shared.append(reduce @ linear.rows.shared[members].reshape(3 * len(members), -1))
        noise.append(covariance)
        kept.append(index)
    if not kept:
        raise IdentificationError(
            readings.provenance.path,
            "points",
            "no step with three points off one line",
            "three such points (full pose)",
        )
    _, configuration = np.unique(steps[kept, 0], return_inverse=True)
    zeros = np.zeros(len(kept), dtype=np.int64)
    rows = Rows(configuration.astype(np.int64), zeros, np.arange(len(kept)), np.stack(noise), np.stack(shared))
    return rows, np.stack(residual), np.stack(columns)


def _rigid(arms: Float2D, noise: Float3D) -> tuple[Float2D, Float2D]:
    """Return the best linear map (6, 3 k) from point displacements to v, w, and the covariance (6, 6) of its result."""
    k = len(arms)
    design = np.zeros((k, 3, 6))
    design[:, :, :3] = np.eye(3)
    x, y, z = arms.T
    design[:, 0, 4], design[:, 0, 5] = z, -y
    design[:, 1, 3], design[:, 1, 5] = -z, x
    design[:, 2, 3], design[:, 2, 4] = y, -x
    weighted = np.linalg.solve(noise, design)
    covariance = np.linalg.inv(np.einsum("kij,kil->jl", design, weighted))
    return covariance @ weighted.reshape(3 * k, 6).T, covariance
