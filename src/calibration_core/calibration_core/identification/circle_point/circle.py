"""Circles through points in space: what a target describes when one joint turns (CWA 17384, 7.1 and 7.2)."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D

PARAMETERS = 6


@dataclasses.dataclass(frozen=True, eq=False)
class Circle:
    """A circle in space.

    Attributes:
        centre: (3,) m.
        normal: (3,) unit vector; its sense follows the order of the points (right-handed).
        radius: m.
        rms: Root mean square of the distances from the circle, per degree of freedom, m.
        arc: Angle that the points span, rad.
        points: Number of points.
    """

    centre: Float1D
    normal: Float1D
    radius: float
    rms: float
    arc: float
    points: int


def fit_circle(points: Float2D) -> Circle:
    """Fit a circle by least squares of the distances in space (axial and radial).

    Args:
        points: (m, 3) m, m >= 4, in the order in which they were passed.

    Raises:
        ValueError: Fewer than four points, or all on one line.
    """
    if len(points) < 4:
        msg = f"{len(points)} points, at least 4 are needed for a circle with an uncertainty"
        raise ValueError(msg)
    middle = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - middle)
    if sizes[1] < 1e-9 * max(sizes[0], 1e-300):
        msg = "the points lie on one line"
        raise ValueError(msg)
    first, second, normal = axes
    start = _in_plane(points - middle, first, second)
    centre = middle + start[0] * first + start[1] * second
    from scipy.optimize import least_squares  # slow to load

    solution = least_squares(
        _residual, np.r_[centre, 0.0, 0.0, start[2]], _jacobian, method="lm", args=(points, normal, first, second),
        xtol=1e-15, ftol=1e-15, gtol=1e-15,
    )  # fmt: skip
    values = solution.x
    turned = _normal(values, normal, first, second)
    freedom = max(2 * len(points) - PARAMETERS, 1)
    variance = 2 * float(solution.cost) / freedom
    angles = _angles(points - values[:3], turned)
    sense = 1.0 if np.median(np.diff(angles)) >= 0 else -1.0
    return Circle(
        centre=values[:3],
        normal=sense * turned,
        radius=float(values[5]),
        rms=float(np.sqrt(variance)),
        arc=float(np.ptp(angles)),
        points=len(points),
    )


def _in_plane(points: Float2D, first: Float1D, second: Float1D) -> Float1D:
    """Return centre and radius of the algebraic circle in the plane of two axes (Coope 1993): a first guess."""
    x, y = points @ first, points @ second
    design = np.column_stack([2 * x, 2 * y, np.ones(len(x))])
    a, b, c = np.linalg.lstsq(design, x**2 + y**2, rcond=None)[0]
    return np.array([a, b, np.sqrt(max(c + a**2 + b**2, 0.0))])


def _normal(values: Float1D, normal: Float1D, first: Float1D, second: Float1D) -> Float1D:
    turned = normal + values[3] * first + values[4] * second
    return turned / np.linalg.norm(turned)


def _residual(values: Float1D, points: Float2D, normal: Float1D, first: Float1D, second: Float1D) -> Float1D:
    axis = _normal(values, normal, first, second)
    arms = points - values[:3]
    axial = arms @ axis
    radial = np.linalg.norm(arms - axial[:, None] * axis, axis=1) - values[5]
    return np.concatenate([axial, radial])


def _jacobian(values: Float1D, points: Float2D, normal: Float1D, first: Float1D, second: Float1D) -> Float2D:
    """Return the derivatives of `_residual`, (2 m, 6)."""
    raw = normal + values[3] * first + values[4] * second
    length = float(np.linalg.norm(raw))
    axis = raw / length
    tilts = [(direction - axis * (axis @ direction)) / length for direction in (first, second)]
    arms = points - values[:3]
    axial = arms @ axis
    across = arms - axial[:, None] * axis
    unit = across / np.linalg.norm(across, axis=1)[:, None]
    m = len(points)
    jacobian = np.zeros((2 * m, PARAMETERS))
    jacobian[:m, :3], jacobian[m:, :3] = -axis, -unit
    for k, tilt in enumerate(tilts):
        jacobian[:m, 3 + k] = arms @ tilt
        jacobian[m:, 3 + k] = -axial * (unit @ tilt)
    jacobian[m:, 5] = -1.0
    return jacobian


def _angles(arms: Float2D, axis: Float1D) -> Float1D:
    """Return the angles about the axis along the sequence of points, unwrapped, rad."""
    across = arms - np.outer(arms @ axis, axis)
    x = across[0] / np.linalg.norm(across[0])
    return np.unwrap(np.arctan2(across @ np.cross(axis, x), across @ x))


FULL = 2 * np.pi
SHORTEST = np.radians(1.0)


def centre_std(arc: float, sigma: float, readings: int) -> float:
    """Return one standard deviation of a circle's centre in its worst direction, along the middle of the arc, m.

    The centre's two coordinates and the radius follow from radial distances alone, with derivatives cos t, sin t and 1
    (Cramér-Rao bound of a circle with free angles; it does not depend on the radius).

    Args:
        arc: Rad, at most a full turn.
        sigma: Standard deviation of one coordinate, m.
        readings: Evenly spaced on the arc, at least 4.

    Raises:
        ValueError: Fewer than four readings, or an arc that is none.
    """
    return float(sigma * np.sqrt(np.linalg.inv(_information(arc, readings))[0, 0]))


def arc_for(accuracy: float, sigma: float, readings: int) -> float | None:
    """Return the shortest arc, rad, whose centre has at most this standard deviation; None if a full turn is too short.

    Args:
        accuracy: Wanted standard deviation of the centre in its worst direction, m.
        sigma: Standard deviation of one coordinate, m.
        readings: Evenly spaced on the arc, at least 4.

    Raises:
        ValueError: Fewer than four readings.
    """
    low, high = SHORTEST, FULL
    if centre_std(high, sigma, readings) > accuracy:
        return None
    if centre_std(low, sigma, readings) <= accuracy:
        return low
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (low, middle) if centre_std(middle, sigma, readings) <= accuracy else (middle, high)
    return high


def _information(arc: float, readings: int) -> Float2D:
    """Return the (3, 3) information on centre (along the middle of the arc, across it) and radius, for unit noise."""
    if readings < 4 or not 0 < arc <= FULL:
        msg = f"{readings} readings on {np.degrees(arc):g} degrees, expected at least 4 on an arc of at most a turn"
        raise ValueError(msg)
    angle = np.linspace(-arc / 2, arc / 2, readings)
    design = np.column_stack([np.cos(angle), np.sin(angle), np.ones(readings)])
    return np.asarray(design.T @ design)
