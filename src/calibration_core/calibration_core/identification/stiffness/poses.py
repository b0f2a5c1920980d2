"""Full pose instead of points: three or more points of a step make one rigid displacement of the tool.

Equation (6) of the standard then has six rows per step: three translations of the centroid and three rotations.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration_core.errors import IdentificationError
from calibration_core.identification.statistics.offsets import Rows
from calibration_core.identification.stiffness.problem import Linearised, LoadedProblem
from calibration_core.timeseries import Float2D, Float3D, Float4D, Int1D, Int2D

LEAST_POINTS = 3
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
    steps, owner, count = np.unique(
        np.column_stack([problem.configuration, readings.step]), axis=0, return_inverse=True, return_counts=True
    )
    order, ends = np.argsort(owner.reshape(-1), kind="stable"), np.cumsum(count)
    parts = [_displaced(linear, order[ends[same, None] - k + np.arange(k)], about) for k, same in _equal(count)]
    if not sum(len(members) for members, *_ in parts):
        raise IdentificationError(
            readings.provenance.path,
            "points",
            "no step with three points off one line",
            "three such points (full pose)",
        )
    first, residual, columns, noise, shared = (np.concatenate(several) for several in zip(*parts, strict=True))
    in_order = np.argsort(owner.reshape(-1)[first])
    kept = owner.reshape(-1)[first][in_order]
    _, configuration = np.unique(steps[kept, 0], return_inverse=True)
    zeros = np.zeros(len(kept), dtype=np.int64)
    rows = Rows(configuration.astype(np.int64), zeros, np.arange(len(kept)), noise[in_order], shared[in_order])
    return rows, residual[in_order], columns[in_order]


def _equal(count: Int1D) -> Iterator[tuple[int, Int1D]]:
    """Yield the numbers of points of steps, three at least, and the steps that have so many."""
    for k in np.unique(count[count >= LEAST_POINTS]):
        yield int(k), np.flatnonzero(count == k)


def _displaced(
    linear: Linearised, members: Int2D, about: Float2D | None
) -> tuple[Int1D, Float2D, Float3D, Float3D, Float3D]:
    """Return the displacements of steps with equally many points.

    Args:
        linear: The problem at some compliances.
        members: (s, k) readings of the steps.
        about: As for `as_poses`.

    Returns:
        Of the steps of which the points are off one line: the first reading, (t,); residual, (t, 6); its derivatives,
        (t, 6, n); its noise, (t, 6, 6); what the shared wrench reading moves, (t, 6, w).
    """
    at = linear.predicted[members]
    arms = at - at.mean(axis=1, keepdims=True)
    spread = np.linalg.svd(arms, compute_uv=False)[:, 1] >= MIN_SPREAD
    members, at, arms = members[spread], at[spread], arms[spread]
    if about is not None:
        arms = at - about[members[:, 0], None]
    reduce, covariance = _rigid(arms, linear.rows.noise[members])
    steps, k = members.shape
    residual, columns, shared = (
        reduce @ values[members].reshape(steps, 3 * k, values.shape[2])
        for values in (linear.residual[:, :, None], linear.columns, linear.rows.shared)
    )
    return members[:, 0], residual[:, :, 0], columns, covariance, shared


def _rigid(arms: Float3D, noise: Float4D) -> tuple[Float3D, Float3D]:
    """Return the best linear map from displacements of a step's points to v, w, and the covariance of its result.

    Args:
        arms: (s, k, 3) m, points of every step.
        noise: (s, k, 3, 3) of their readings.

    Returns:
        (s, 6, 3 k) and (s, 6, 6).
    """
    steps, k, _ = arms.shape
    design = np.zeros((steps, k, 3, 6))
    design[..., :3] = np.eye(3)
    x, y, z = np.moveaxis(arms, -1, 0)
    design[..., 0, 4], design[..., 0, 5] = z, -y
    design[..., 1, 3], design[..., 1, 5] = -z, x
    design[..., 2, 3], design[..., 2, 4] = y, -x
    weighted = np.linalg.solve(noise, design).reshape(steps, 3 * k, 6).transpose(0, 2, 1)
    covariance = np.asarray(np.linalg.inv(weighted @ design.reshape(steps, 3 * k, 6)), dtype=np.float64)
    return covariance @ weighted, covariance
