"""Circles through points in space: what a target describes when one joint turns (CWA 17384, 7.1 and 7.2).

Circles about one axis: what several targets on the robot describe while one joint turns (CWA 17384, 7.1 and 7.2).

Every target has its own height and radius; the axis is the same for all, so it is fitted to all of them at once.  The
angles along the circles are left free, as the circle point method has it: an error of the transmission shifts a target
along its circle and does not touch the axis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

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


# --- circles about one axis -------------------------------------------------------------------------------------------


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
