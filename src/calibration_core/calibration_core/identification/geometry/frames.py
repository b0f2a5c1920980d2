"""Tracker pose and measurement points from absolute positions, with or without a first guess.

Model: R_t y + t = p_flange + R_flange u_j for reading y (tracker frame) of point j.  It is linear in the nine entries
of R_t, in t and in u, so a first solution needs no guess; Gauss-Newton on the rotation then finishes.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.model.chain import aligned, nearest_rotation, rotation_about
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
            `scatter` and what the geometry of a robot is usually off by, as far as the residuals show it: readings of
            near postures share that.
        rms: Root mean square per coordinate, m.
        rank: Number of parameters that the readings determine; the others keep their first guess.
        scatter: The part of `covariance` that the residuals show, and the claimed noise at the least.
        freedom: Degrees of freedom; with none the frames take up whatever the model leaves out.
    """

    tracker: Float2D
    points: Float2D
    covariance: Float2D
    rms: float
    rank: int
    scatter: Float2D
    freedom: int


def fit_frames(
    at: Posture,
    position: Float2D,
    point: Int1D,
    points: Float2D,
    tracker: Float2D | None,
    claimed: float = 0.0,
    usual: tuple[float, float] = (0.0, 0.0),
) -> FrameFit:
    """Fit the tracker pose and the measurement points to absolute positions by least squares.

    Args:
        at: Posture of the m readings, deflections included.
        position: (m, 3) m, tracker frame.
        point: (m,) index of the measurement point of each reading.
        points: (k, 3) m, first guess of the points in the flange frame.
        tracker: (4, 4) first guess of the tracker pose; None if there is none.
        claimed: Standard deviation of a coordinate that the instrument claims, m.
        usual: Standard deviations of what the frame before a joint is off by, m along and rad about each of its axes.
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
    freedom = len(residual) - rank
    variance = max(float(residual @ residual) / max(freedom, 1), claimed**2)
    errors = _geometry(at, at.point(tool[point].T), usual)
    taken_up = inverse @ (columns.T @ errors)
    shared = taken_up * np.sqrt(_seen(residual, errors - columns @ taken_up, freedom, claimed))
    scatter, rms = inverse * variance, float(np.sqrt(np.mean(residual**2)))
    return FrameFit(pose, tool, scatter + shared @ shared.T, rms, rank, scatter, freedom)


def _seen(residual: Float1D, expected: Float2D, freedom: int, claimed: float) -> float:
    """Return which part of the usual variance of a geometry the residual shows, all of it at the most.

    The residual's part that no error of the geometry makes says how large the noise is.  The part is no less than what
    this noise can hide: the standard deviation of its sum of squares.

    Args:
        residual: (3 m,) m, what the frames leave.
        expected: (3 m, e) m, what the usual errors would leave of it, one by one.
        freedom: Degrees of freedom of the residual; with none it shows nothing.
        claimed: Standard deviation of a coordinate, m.
    """
    basis, size, _ = np.linalg.svd(expected, full_matrices=False)
    basis = basis[:, size > RANK_TOLERANCE * size.max(initial=0.0)]
    rank, whole = basis.shape[1], float(np.sum(size**2))
    if freedom == 0 or rank == 0:
        return 1.0
    along = basis.T @ residual
    others = max(float(residual @ residual - along @ along), 0.0)
    variance = max(others / (freedom - rank), claimed**2) if freedom > rank else claimed**2
    excess = float(along @ along) - rank * variance
    return min(max(excess, np.sqrt(2.0 * rank) * variance) / whole, 1.0)


def _geometry(at: Posture, point: Float2D, usual: tuple[float, float]) -> Float2D:
    """Return (3 m, 6 n) what the usual errors of the frames before the joints move the points, (3, m) m."""
    shift, turn = usual
    axes = [(axis, origin) for frame, origin in zip(at.before, at.origin, strict=True) for axis in frame]
    moved = [np.stack([shift * axis, turn * np.cross(axis, point - origin, axis=0)], axis=-1) for axis, origin in axes]
    return np.concatenate(moved, axis=-1).transpose(1, 0, 2).reshape(point.size, -1)


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
        rotation = aligned(at.point(points[point].T).T, position)
    pose = np.eye(4)
    pose[:3, :3] = nearest_rotation(rotation)
    pose[:3, 3] = np.mean(at.point(points[point].T).T - position @ pose[:3, :3].T, axis=0)
    return pose
