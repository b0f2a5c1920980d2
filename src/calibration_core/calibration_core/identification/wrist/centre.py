"""The wrist centre point by spheres and trilateration (CWA 17384, 7.3)."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.circle_point.joint_axes import LEAST, Sweep, wrist_sweep
from calibration_core.identification.wrist.fit import fit_wrist
from calibration_core.identification.wrist.sphere import Sphere, fit_sphere, trilaterate
from calibration_core.model.robot import chain_of
from calibration_core.observations.covariance import coordinate_std, position_covariance
from calibration_core.timeseries import Float1D, Float2D, Int1D, Readings

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
        warnings: What limits the result.
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
