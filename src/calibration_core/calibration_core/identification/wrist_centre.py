"""The wrist centre point by spheres and trilateration (CWA 17384, 7.3)."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.sphere import Sphere, fit_sphere, trilaterate
from calibration_core.identification.sweeps import wrist_sweep
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float1D, Readings

WRIST = 3  # joints


@dataclasses.dataclass(frozen=True, eq=False)
class WristCentre:
    """The point where the wrist axes meet.

    Attributes:
        position: (3,) m, tracker frame, by trilateration.
        sphere_centres: Measurement point -> (3,) m: each sphere's own centre, for comparison.
        spread: m, root mean square distance of the sphere centres from `position`: how far the wrist is from spherical,
            and how well the points determine it.
        spheres: One per measurement point.
        std: m, per coordinate.
    """

    position: Float1D
    sphere_centres: dict[str, Float1D]
    spread: float
    spheres: tuple[Sphere, ...]
    std: float


def identify_wrist_centre(readings: Readings, cell: Cell) -> WristCentre:
    """Fit one sphere per measurement point while the wrist joints move and the arm stands, then trilaterate.

    The spheres' radii are distances from the points to the wrist centre; with the three points of one pose as centres
    they meet in two places, of which the one near the spheres' own centres is the wrist centre.  The mean over all
    poses is taken.

    Raises:
        IdentificationError: Fewer than three points, or no stretch in which only the wrist moves.
    """
    path = readings.provenance.path
    n = chain_of(cell).n
    sweeps = wrist_sweep(readings.q, readings.point, tuple(range(n - WRIST, n)))
    if len(sweeps) < 3:
        raise IdentificationError(
            path,
            "points",
            f"{len(sweeps)} with a wrist motion",
            "three points seen while only the last three joints move",
        )
    try:
        spheres = [fit_sphere(readings.position[sweep.rows]) for sweep in sweeps]
    except ValueError as error:
        raise IdentificationError(
            path, "wrist motion", str(error), "poses spread over all three wrist joints"
        ) from None
    near = np.mean([sphere.centre for sphere in spheres], axis=0)
    radii = np.array([sphere.radius for sphere in spheres[:3]])
    common = min(len(sweep.rows) for sweep in sweeps[:3])
    found = []
    for k in range(common):
        corners = np.stack([readings.position[sweep.rows[k]] for sweep in sweeps[:3]])
        try:
            both = trilaterate(corners, radii)
        except ValueError as error:
            raise IdentificationError(path, "points", str(error), "three points at the corners of a triangle") from None
        found.append(both[np.argmin(np.linalg.norm(both - near, axis=1))])
    position = np.mean(found, axis=0)
    names = [readings.points[int(readings.point[sweep.rows[0]])] for sweep in sweeps]
    centres = {name: sphere.centre for name, sphere in zip(names, spheres, strict=True)}
    spread = float(np.sqrt(np.mean([np.sum((centre - position) ** 2) for centre in centres.values()])))
    scatter = float(np.sqrt(np.mean(np.var(found, axis=0)) / common))
    return WristCentre(position, centres, spread, tuple(spheres), scatter)
