"""The wrist centre point by spheres and trilateration (CWA 17384, 7.3).

The wrist centre from all readings at once: a rigid triangle that turns about a point.

Spheres and trilateration use the points one by one and take the radii as found; that leaves out that the points keep
their distances.  Here every pose of the wrist has its own rotation R_i, and reading k of pose i is

    x_ki = c + R_i (p_k - w)

with the wrist centre w in the flange frame and c where the arm holds it in the tracker frame.  The points p_k are known
with a covariance.  The rotations are eliminated pose by pose.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.circle_point.joint_axes import LEAST, Sweep, wrist_sweep
from calibration_core.identification.statistics import LEVEL, chi2_limit, scaled_inverse
from calibration_core.model.chain import nearest_rotation, rotation_about
from calibration_core.model.robot import chain_of
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings

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
    """Return the information on w, c (none) and the points; directions that are exact stay as they are."""
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


# --- spheres through points -------------------------------------------------------------------------------------------


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


# --- the wrist centre point by spheres and trilateration (CWA 17384, 7.3) ---------------------------------------------


WRIST = 3  # joints
CORNERS = 3  # points that trilateration takes
OFF = 2.0  # times the tracker's noise that points may lie off their spheres


@dataclasses.dataclass(frozen=True, eq=False)
class WristCentre:
    """The point where the wrist axes meet.

    Attributes:
        position: (3,) m, tracker frame, where the arm stood during the wrist motion.
        flange: (3,) m, flange frame.
        covariance: (3, 3) m^2, of `flange`: from all readings and from the points.
        position_covariance: (3, 3) m^2, of `position`.
        trilaterated: (3,) m, flange frame, by spheres and trilateration alone: where the fit of all readings began.
        spread: m, root mean square distance of the sphere centres from `position`: how far the wrist is from spherical,
            and how well the points determine it.
    """

    position: Float1D
    flange: Float1D
    covariance: Float2D
    position_covariance: Float2D
    trilaterated: Float1D
    spread: float
    warnings: tuple[str, ...]

    @property
    def std(self) -> Float1D:
        """(3,) m, of `flange`."""
        return np.sqrt(np.diag(self.covariance))


def identify_wrist_centre(
    readings: Readings, cell: Cell, points: Mapping[str, Float1D], covariance: Float2D | None = None
) -> WristCentre:
    """Fit one sphere per measurement point while the wrist joints move and the arm stands, then trilaterate.

    The spheres' radii are distances from the points to the wrist centre.  With the three points of one pose as centres
    they meet in two places, of which the one near the spheres' own centres is the wrist centre; the mean over all
    poses is taken.  With the points on the flange as centres they meet on the same side of them in the flange frame.
    Both begin a fit of all readings that also uses that the points keep their distances (`fit`).

    Args:
        readings: The recording.
        cell: The cell file.
        points: Measurement point -> (3,) m, flange frame.
        covariance: (3 k, 3 k) m^2 of the points in the order of the readings' points; None: taken as exact.

    Raises:
        IdentificationError: Fewer than three points, no stretch in which only the wrist moves, or no wrist at all.
    """
    path = readings.provenance.path
    chain = chain_of(cell)
    n = chain.n
    if not chain.wrist_apart(WRIST):
        raise IdentificationError(path, "joints", "mimic joints in the wrist", "last three joints that move alone")
    if n <= WRIST:
        raise IdentificationError(path, "joints", f"{n}", f"more than {WRIST}: an arm that carries a wrist")
    sweeps = wrist_sweep(readings.q, readings.point, tuple(range(n - WRIST, n)))
    if len(sweeps) < CORNERS:
        raise IdentificationError(
            path,
            "points",
            f"{len(sweeps)} with a wrist motion",
            "three points seen while only the last three joints move",
        )
    try:
        spheres = [fit_sphere(readings.position[sweep.rows]) for sweep in sweeps]
        position, side = _mean(readings, sweeps[:CORNERS], spheres)
        indices = [int(readings.point[sweep.rows[0]]) for sweep in sweeps]
        names = [readings.points[index] for index in indices]
        corners = np.stack([points[name] for name in names[:CORNERS]])
        radii = np.array([sphere.radius for sphere in spheres[:CORNERS]])
        trilaterated = trilaterate(corners, radii)[side]
        chosen = _together(readings, sweeps)
        local = np.stack([points[name] for name in names])
        noise = position_covariance(readings, cell)[chosen]
        known = None if covariance is None else _of_corners(covariance, indices)
        fit = fit_wrist(readings.position[chosen], noise, local, known, trilaterated, position)
    except ValueError as error:
        expected = "three points that are no line, and poses spread over all three wrist joints"
        raise IdentificationError(path, "wrist motion", str(error), expected) from None
    spread = float(np.sqrt(np.mean([np.sum((sphere.centre - fit.position) ** 2) for sphere in spheres])))
    return WristCentre(
        position=fit.position,
        flange=fit.flange,
        covariance=fit.covariance[:3, :3],
        position_covariance=fit.covariance[3:, 3:],
        trilaterated=trilaterated,
        spread=spread,
        warnings=_warnings(readings, cell, sweeps, spheres),
    )


def _mean(readings: Readings, sweeps: tuple[Sweep, ...], spheres: list[Sphere]) -> tuple[Float1D, int]:
    """Return the mean place where the spheres about the points of one pose meet, (3,) m, and which of the two it is."""
    near = np.mean([sphere.centre for sphere in spheres], axis=0)
    radii = np.array([sphere.radius for sphere in spheres[:CORNERS]])
    found, sides = [], []
    for k in range(min(len(sweep.rows) for sweep in sweeps)):
        both = trilaterate(np.stack([readings.position[sweep.rows[k]] for sweep in sweeps]), radii)
        side = int(np.argmin(np.linalg.norm(both - near, axis=1)))
        sides.append(side)
        found.append(both[side])
    return np.mean(found, axis=0), int(np.round(np.mean(sides)))


def _together(readings: Readings, sweeps: tuple[Sweep, ...]) -> Int1D:
    """Return (m, k) rows of the poses in which all k points were seen."""
    pose = readings.configuration * (int(readings.step.max()) + 1) + readings.step
    keys = [pose[sweep.rows] for sweep in sweeps]
    common = functools.reduce(np.intersect1d, keys)
    if len(common) < LEAST:
        msg = f"{len(common)} poses in which all points were seen, at least {LEAST} are needed"
        raise ValueError(msg)
    return np.stack(
        [sweep.rows[[int(np.argmax(key == one)) for one in common]] for sweep, key in zip(sweeps, keys, strict=True)],
        axis=1,
    )


def _of_corners(covariance: Float2D, indices: list[int]) -> Float2D:
    rows = np.concatenate([3 * index + np.arange(3) for index in indices])
    return covariance[np.ix_(rows, rows)]


def _warnings(readings: Readings, cell: Cell, sweeps: tuple[Sweep, ...], spheres: list[Sphere]) -> tuple[str, ...]:
    rows = np.concatenate([sweep.rows for sweep in sweeps])
    noise = coordinate_std(position_covariance(readings, cell)[rows])
    off = float(np.sqrt(np.mean([sphere.rms**2 for sphere in spheres])))
    if off <= OFF * noise:
        return ()
    text = f"the points keep to their spheres to {1e6 * off:.0f} µm (tracker: {1e6 * noise:.0f} µm)"
    return (f"{text}: the wrist axes may not meet in one point",)
