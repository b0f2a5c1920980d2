"""Tracker pose and measurement points from absolute positions, with or without a first guess.

Model: R_t y + t = p_flange + R_flange u_j for reading y (tracker frame) of point j.  It is linear in the nine entries
of R_t, in t and in u, so a first solution needs no guess; Gauss-Newton on the rotation then finishes.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.model.chain import rotation_about
from calibration_core.model.kinematics import Posture
from calibration_core.timeseries import Float1D, Float2D, Int1D

ITERATIONS = 25
CONVERGED = 1e-12  # m, rad
RANK_TOLERANCE = 1e-4  # singular values of the scaled system below this fraction of the largest are left at the guess


@dataclasses.dataclass(frozen=True, eq=False)
class FrameFit:
    """The best frames under a given robot model.

    Attributes:
        tracker: (4, 4) pose of the tracker frame in the base frame.
        points: (k, 3) m, measurement points in the flange frame.
        covariance: (6 + 3 k, 6 + 3 k) of tracker position (m), tracker rotation (rad, base axes) and points (m),
            from the residuals' own scatter.
        rms: Root mean square per coordinate, m.
        rank: Number of parameters that the readings determine; the others keep their first guess.
    """

    tracker: Float2D
    points: Float2D
    covariance: Float2D
    rms: float
    rank: int


def fit_frames(at: Posture, position: Float2D, point: Int1D, points: Float2D, tracker: Float2D | None) -> FrameFit:
    """Fit the tracker pose and the measurement points to absolute positions by least squares.

    Args:
        at: Posture of the m readings, deflections included.
        position: (m, 3) m, tracker frame.
        point: (m,) index of the measurement point of each reading.
        points: (k, 3) m, first guess of the points in the flange frame.
        tracker: (4, 4) first guess of the tracker pose; None if there is none.
    """
    pose = _first_guess(at, position, point, points) if tracker is None else np.array(tracker)
    tool = np.array(points, dtype=float)
    k = len(tool)
    scale = np.concatenate(
        [np.ones(3), np.full(3, float(np.linalg.norm(position, axis=1).max(initial=1.0))), np.ones(3 * k)]
    )
    for _ in range(ITERATIONS):
        residual, columns = _linearise(at, position, point, tool, pose)
        inverse, _ = _inverse(columns, scale)
        step = inverse @ (columns.T @ residual)
        pose[:3, 3] += step[:3]
        pose[:3, :3] = rotation_about(step[3:6]) @ pose[:3, :3]
        tool = tool + step[6:].reshape(k, 3)
        if np.abs(step).max() < CONVERGED:
            break
    residual, columns = _linearise(at, position, point, tool, pose)
    inverse, rank = _inverse(columns, scale)
    variance = float(residual @ residual) / max(len(residual) - rank, 1)
    return FrameFit(pose, tool, inverse * variance, float(np.sqrt(np.mean(residual**2))), rank)


def _inverse(columns: Float2D, scale: Float1D) -> tuple[Float2D, int]:
    """Return the inverse of the normal matrix in the directions that the readings determine, and their number."""
    scaled = columns / scale
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > RANK_TOLERANCE**2 * values[-1]
    weights = np.where(kept, 1 / np.where(kept, values, 1.0), 0.0)
    return (vectors * weights) @ vectors.T / np.outer(scale, scale), int(kept.sum())


def _linearise(at: Posture, position: Float2D, point: Int1D, tool: Float2D, pose: Float2D) -> tuple[Float1D, Float2D]:
    """Return what is left, (3 m,), and its derivatives, (3 m, 6 + 3 k)."""
    m, k = len(position), len(tool)
    turned = position @ pose[:3, :3].T
    residual = at.point(tool[point].T).T - turned - pose[:3, 3]
    columns = np.zeros((m, 3, 6 + 3 * k))
    columns[:, :, :3] = np.eye(3)
    columns[:, :, 3:6] = _minus_skew(turned)
    flange = -np.moveaxis(at.flange, -1, 0).transpose(0, 2, 1)  # (m, 3, 3), rows are base axes
    for j in range(k):
        rows = point == j
        columns[rows, :, 6 + 3 * j : 9 + 3 * j] = flange[rows]
    return residual.reshape(-1), columns.reshape(3 * m, -1)


def _minus_skew(vectors: Float2D) -> Float2D:
    """Return (m, 3, 3) with row-wise d(w x v)/dw = -S(v)."""
    result = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    result[:, 0, 1], result[:, 0, 2] = z, -y
    result[:, 1, 0], result[:, 1, 2] = -z, x
    result[:, 2, 0], result[:, 2, 1] = y, -x
    return result


def _first_guess(at: Posture, position: Float2D, point: Int1D, points: Float2D) -> Float2D:
    """Return a tracker pose from the linear problem, or from point clouds where that one is degenerate."""
    m, k = len(position), len(points)
    columns = np.zeros((m, 3, 12 + 3 * k))
    for axis in range(3):
        columns[:, axis, 3 * axis : 3 * axis + 3] = position
        columns[:, axis, 9 + axis] = 1.0
    flange = np.moveaxis(at.flange, -1, 0).transpose(0, 2, 1)
    for j in range(k):
        rows = point == j
        columns[rows, :, 12 + 3 * j : 15 + 3 * j] = -flange[rows]
    target = at.flange_origin.T
    flat = columns.reshape(3 * m, -1)
    solution, _, rank, _ = np.linalg.lstsq(flat, target.reshape(-1), rcond=1e-9)
    rotation = solution[:9].reshape(3, 3)
    if rank < flat.shape[1] or np.linalg.det(rotation) <= 0:
        rotation = _procrustes(position, at.point(points[point].T).T)
    u, _, vt = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    pose[:3, 3] = np.mean(at.point(points[point].T).T - position @ pose[:3, :3].T, axis=0)
    return pose


def _procrustes(source: Float2D, target: Float2D) -> Float2D:
    """Return the rotation that best takes the centred `source` to the centred `target` (Kabsch, 1976)."""
    u, _, vt = np.linalg.svd((target - target.mean(0)).T @ (source - source.mean(0)))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
