"""Spheres through points: what a target describes when the three wrist joints turn (CWA 17384, 7.3)."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D

PARAMETERS = 4
FLAT = 1e-3  # thinnest extent of the points relative to the widest


@dataclasses.dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere.

    Attributes:
        centre: (3,) m.
        radius: m.
        covariance: (4, 4) of centre and radius, m^2, from the points' own scatter.
        rms: Root mean square distance from the sphere per degree of freedom, m.
    """

    centre: Float1D
    radius: float
    covariance: Float2D
    rms: float


def fit_sphere(points: Float2D) -> Sphere:
    """Fit a sphere by least squares of the radial distances.

    Args:
        points: (m, 3) m, m >= 5, not all in one plane.

    Raises:
        ValueError: Too few points, or all nearly in one plane.
    """
    if len(points) < PARAMETERS + 1:
        msg = f"{len(points)} points, at least {PARAMETERS + 1} are needed for a sphere with an uncertainty"
        raise ValueError(msg)
    middle = points.mean(axis=0)
    arms = points - middle
    sizes = np.linalg.svd(arms, compute_uv=False)
    if sizes[2] < FLAT * sizes[0]:
        msg = "the points lie in one plane"
        raise ValueError(msg)
    design = np.column_stack([2 * arms, np.ones(len(arms))])
    *guess, c = np.linalg.lstsq(design, (arms**2).sum(axis=1), rcond=None)[0]
    centre = np.array(guess)
    start = np.r_[middle + centre, np.sqrt(max(c + centre @ centre, 1e-12))]
    from scipy.optimize import least_squares  # slow to load

    solution = least_squares(
        _residual, start, _jacobian, method="lm", args=(points,), xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    variance = 2 * float(solution.cost) / (len(points) - PARAMETERS)
    covariance = np.linalg.inv(solution.jac.T @ solution.jac) * variance
    return Sphere(solution.x[:3], float(solution.x[3]), covariance, float(np.sqrt(variance)))


def trilaterate(centres: Float2D, radii: Float1D) -> Float2D:
    """Return the two points that three spheres have in common, (2, 3) m.

    Args:
        centres: (3, 3) m, one per row, not on one line.
        radii: (3,) m.

    Raises:
        ValueError: The centres lie on one line, or the spheres have no common point.
    """
    first, second, third = centres
    x = second - first
    d = float(np.linalg.norm(x))
    x = x / max(d, 1e-300)
    i = float(x @ (third - first))
    across = third - first - i * x
    j = float(np.linalg.norm(across))
    if d < 1e-9 or j < 1e-6 * d:
        msg = "the three points lie on one line"
        raise ValueError(msg)
    y = across / j
    a = (radii[0] ** 2 - radii[1] ** 2 + d**2) / (2 * d)
    b = (radii[0] ** 2 - radii[2] ** 2 + i**2 + j**2 - 2 * i * a) / (2 * j)
    height = radii[0] ** 2 - a**2 - b**2
    if height < -1e-6 * radii[0] ** 2:
        msg = "the three spheres have no point in common"
        raise ValueError(msg)
    z = np.cross(x, y) * np.sqrt(max(height, 0.0))
    foot = first + a * x + b * y
    return np.stack([foot + z, foot - z])


def _residual(values: Float1D, points: Float2D) -> Float1D:
    return np.linalg.norm(points - values[:3], axis=1) - values[3]


def _jacobian(values: Float1D, points: Float2D) -> Float2D:
    arms = points - values[:3]
    unit = arms / np.linalg.norm(arms, axis=1)[:, None]
    return np.column_stack([-unit, -np.ones(len(points))])
