"""The wrist centre from all readings at once: a rigid triangle that turns about a point.

Spheres and trilateration use the points one by one and take the radii as found; that leaves out that the points keep
their distances.  Here every pose of the wrist has its own rotation R_i, and reading k of pose i is

    x_ki = c + R_i (p_k - w)

with the wrist centre w in the flange frame and c where the arm holds it in the tracker frame.  The points p_k are known
with a covariance.  The rotations are eliminated pose by pose.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration_core.identification.statistics.distributions import LEVEL, chi2_limit
from calibration_core.identification.statistics.solve import scaled_inverse
from calibration_core.model.chain import nearest_rotation, rotation_about
from calibration_core.timeseries import Float1D, Float2D, Float3D

ITERATIONS = 30
CONVERGED = 1e-12  # m
EXACT = 1e-9  # m: standard deviation of what is exact
SINGULAR = 1e-9  # smallest eigenvalue of the scaled normal matrix

Float4D = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class WristFit:
    """Where the wrist centre is.

    Attributes:
        flange: (3,) m, flange frame.
        position: (3,) m, tracker frame.
        covariance: (6, 6) of both, m^2; widened by `scale`.
        scale: Factor by which the residuals exceed the claimed noise, where noise does not explain them (1: it does).
        rms: Root mean square of the residuals per coordinate, m.
    """

    flange: Float1D
    position: Float1D
    covariance: Float2D
    scale: float
    rms: float


def fit_wrist(
    seen: Float3D, noise: Float4D, points: Float2D, covariance: Float2D | None, flange: Float1D, position: Float1D
) -> WristFit:
    """Fit the wrist centre by Gauss-Newton.

    Args:
        seen: (m, k, 3) m, tracker frame: k >= 3 points in m poses of the wrist.
        noise: (m, k, 3, 3) m^2, covariance of the readings.
        points: (k, 3) m, flange frame.
        covariance: (3 k, 3 k) m^2 of the points; None: exact.
        flange: (3,) m, first guess of the wrist centre.
        position: (3,) m, first guess in the tracker frame.

    Raises:
        ValueError: The poses do not fix the centre.
    """
    m, k, _ = seen.shape
    white = np.linalg.inv(np.linalg.cholesky(noise))
    prior = np.zeros((6, 6)) if covariance is None or not np.any(covariance) else _prior(covariance)
    with_alternatives = len(prior) > 6
    values = np.concatenate([flange, position, np.zeros(len(prior) - 6)])
    turns = _rotations(points - flange, seen - position)
    now = _linearised(seen, white, points, values, turns, with_alternatives=with_alternatives)
    for _ in range(ITERATIONS):
        matrix, vector = now.matrix + prior, now.vector - prior @ np.concatenate([np.zeros(6), values[6:]])
        size = 1 / np.sqrt(np.diag(now.matrix)[:6])
        if np.linalg.eigvalsh(now.matrix[:6, :6] * np.outer(size, size))[0] < SINGULAR:
            msg = "the wrist turned about fewer than two axes"
            raise ValueError(msg)
        scale = 1 / np.sqrt(np.diag(matrix))
        step = scale * np.linalg.solve(matrix * np.outer(scale, scale), scale * vector)
        values = values + step
        about = now.about - now.slope @ step
        turns = np.stack([rotation_about(angle) @ turn for angle, turn in zip(about, turns, strict=True)])
        now = _linearised(seen, white, points, values, turns, with_alternatives=with_alternatives)
        if np.abs(step).max() < CONVERGED:
            break
    freedom = (3 * k - 3) * m - 6
    ratio = float(np.sqrt(now.chi2 / freedom))
    widened = ratio if now.chi2 > chi2_limit(LEVEL, freedom) and ratio > 1.0 else 1.0
    covariance = scaled_inverse(now.matrix / widened**2 + prior)[:6, :6]
    return WristFit(values[:3], values[3:6], covariance, widened, now.rms)


@dataclasses.dataclass(frozen=True, eq=False)
class _Linearised:
    """Normal equations without the rotations, whose own steps are `about` - `slope` times the step of the others."""

    matrix: Float2D
    vector: Float1D
    about: Float2D
    slope: Float3D
    chi2: float
    rms: float


def _linearised(
    seen: Float3D, white: Float4D, points: Float2D, values: Float1D, turns: Float3D, *, with_alternatives: bool
) -> _Linearised:
    m, k, _ = seen.shape
    local = points - values[:3] + (values[6:].reshape(k, 3) if with_alternatives else 0.0)
    arms = local @ np.swapaxes(turns, 1, 2)
    columns = np.zeros((m, k, 3, len(values)))
    columns[..., :3] = -turns[:, None]
    columns[..., 3:6] = np.eye(3)
    for j in range(k if with_alternatives else 0):
        columns[:, j, :, 6 + 3 * j : 9 + 3 * j] = turns
    residual = seen - values[3:6] - arms
    flat, turning, data = (
        (white @ block).reshape(m, 3 * k, -1) for block in (columns, -_skew(arms), residual[..., None])
    )
    basis, triangle = np.linalg.qr(turning)
    left = np.swapaxes(basis, 1, 2)
    free, rest = flat - basis @ (left @ flat), data - basis @ (left @ data)
    return _Linearised(
        matrix=np.einsum("mri,mrj->ij", free, free),
        vector=np.einsum("mri,mro->i", free, rest),
        about=np.linalg.solve(triangle, left @ data)[..., 0],
        slope=np.linalg.solve(triangle, left @ flat),
        chi2=float(np.sum(rest**2)),
        rms=float(np.sqrt(np.mean(residual**2))),
    )


def _prior(covariance: Float2D) -> Float2D:
    """Return the information on w, c (none) and the points; directions without any doubt stay as they are."""
    known = np.linalg.pinv(covariance, rcond=1e-10, hermitian=True)
    sure = np.eye(len(covariance)) - known @ covariance
    prior = np.zeros((6 + len(covariance), 6 + len(covariance)))
    prior[6:, 6:] = known + sure @ sure.T / EXACT**2
    return prior


def _rotations(local: Float2D, seen: Float3D) -> Float3D:
    """Return the rotations (m, 3, 3) that best take the arms (k, 3) to those seen, (m, k, 3)."""
    return nearest_rotation(np.einsum("mka,kb->mab", seen, local))


def _skew(vectors: Float3D) -> Float4D:
    """Return (m, k, 3, 3) with S(v) w = v x w."""
    result = np.zeros((*vectors.shape, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    result[..., 0, 1], result[..., 0, 2] = -z, y
    result[..., 1, 0], result[..., 1, 2] = z, -x
    result[..., 2, 0], result[..., 2, 1] = -y, x
    return result
