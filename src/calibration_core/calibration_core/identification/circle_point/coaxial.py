"""Circles about one axis: what several targets on the robot describe while one joint turns (CWA 17384, 7.1 and 7.2).

Every target has its own height and radius; the axis is the same for all, so it is fitted to all of them at once.  The
angles along the circles are left free, as the circle point method has it: an error of the transmission shifts a target
along its circle and does not touch the axis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.identification.circle_point.circle import Circle
from calibration_core.timeseries import Float1D, Float2D

ITERATIONS = 30
CONVERGED = 1e-13  # m and rad


@dataclasses.dataclass(frozen=True, eq=False)
class Coaxial:
    """Circles about one axis.

    Attributes:
        centres: (k, 3) m, one per circle, all on the axis.
        normal: (3,) unit vector along the axis, in the sense of the circles given.
        covariance: (4 + 2 k, 4 + 2 k) of shift of the axis along two directions across it (m), its tilts towards these
            (rad), heights of the circles along it (m) and radii (m); from the points' own scatter.
        across: (2, 3) these two unit vectors; the shifts are at the foot from which heights count.
        heights: (k,) m.
        rms: Root mean square of the distances from the circles per degree of freedom, m.
    """

    centres: Float2D
    normal: Float1D
    covariance: Float2D
    across: Float2D
    heights: Float1D
    rms: float

    def line_covariance(self, circle: int) -> Float2D:
        """(6, 6) covariance of the centre of one circle (m) and of the normal (-)."""
        change = np.zeros((6, len(self.covariance)))
        change[:3, :2] = self.across.T
        change[:3, 2:4] = self.heights[circle] * self.across.T
        change[:3, 4 + circle] = self.normal
        change[3:, 2:4] = self.across.T
        return change @ self.covariance @ change.T


def fit_coaxial(circles: Sequence[Circle], points: Sequence[Float2D]) -> Coaxial:
    """Fit one axis to the points of several circles, by least squares of axial and radial distances.

    Args:
        circles: Each fitted alone, normals in one sense: the first guess.
        points: Of each circle, (m, 3) m.

    Raises:
        ValueError: The points do not fix an axis.
    """
    k = len(circles)
    normal = np.sum([circle.normal for circle in circles], axis=0)
    normal = normal / np.linalg.norm(normal)
    foot = np.mean([circle.centre for circle in circles], axis=0)
    heights = np.array([(circle.centre - foot) @ normal for circle in circles])
    radii = np.array([circle.radius for circle in circles])
    for _ in range(ITERATIONS):
        across = np.linalg.svd(normal[None])[2][1:]
        residual, jacobian = _linearised(points, foot, normal, across, heights, radii)
        step, _, rank, _ = np.linalg.lstsq(jacobian, -residual, rcond=1e-12)
        if rank < 4 + 2 * k:
            msg = "the points do not fix an axis"
            raise ValueError(msg)
        foot = foot + step[:2] @ across
        normal = normal + step[2:4] @ across
        normal = normal / np.linalg.norm(normal)
        heights, radii = heights + step[4 : 4 + k], radii + step[4 + k :]
        if np.abs(step).max() < CONVERGED:
            break
    across = np.linalg.svd(normal[None])[2][1:]
    residual, jacobian = _linearised(points, foot, normal, across, heights, radii)
    variance = float(residual @ residual) / max(len(residual) - 4 - 2 * k, 1)
    return Coaxial(
        centres=foot + np.outer(heights, normal),
        normal=normal,
        covariance=np.asarray(np.linalg.inv(jacobian.T @ jacobian) * variance, dtype=np.float64),
        across=across,
        heights=heights,
        rms=float(np.sqrt(variance)),
    )


def _linearised(
    points: Sequence[Float2D], foot: Float1D, normal: Float1D, across: Float2D, heights: Float1D, radii: Float1D
) -> tuple[Float1D, Float2D]:
    """Return axial and radial distances, (2 m,), and their derivatives by shifts, tilts, heights and radii."""
    k = len(points)
    residuals, rows = [], []
    for i, some in enumerate(points):
        arms = some - foot
        axial = arms @ normal
        radial = arms - axial[:, None] * normal
        distance = np.linalg.norm(radial, axis=1)
        unit = radial / distance[:, None]
        block = np.zeros((2 * len(some), 4 + 2 * k))
        block[: len(some), 2:4] = arms @ across.T
        block[len(some) :, :2] = -unit @ across.T
        block[len(some) :, 2:4] = -axial[:, None] * (unit @ across.T)
        block[: len(some), 4 + i] = -1.0
        block[len(some) :, 4 + k + i] = -1.0
        residuals += [axial - heights[i], distance - radii[i]]
        rows.append(block)
    return np.concatenate(residuals), np.concatenate(rows)
