"""What is left after the fit of absolute positions: noise, or something that depends on posture?

Neighbouring postures share almost everything that depends on posture, but not their noise.  Differences of residuals
between neighbours therefore bound the noise from above, without any model of what is missing.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.identification.checks.noise_audit import audit, rejects
from calibration_core.identification.result.estimate import REPEATS, TRIANGLE, NoiseAudit, NoiseCheck
from calibration_core.timeseries import Float2D, Float3D, Int1D

ENOUGH = 50  # readings below which neighbours say nothing
CLOSEST = 0.1  # share of the pairs that counts as closest
CLEAR = 3.0  # standard errors
REPEATED = 1e-3  # rad; closer postures count as one
NEIGHBOURS = "neighbouring postures"


@dataclasses.dataclass(frozen=True)
class Neighbours:
    """Residuals of neighbouring postures compared.

    Attributes:
        seen: Standard deviation of one coordinate from the differences of all neighbours, m: a bound of the noise.
        closest: The same from the closest tenth of the pairs, m.
        distance: Largest distance within that tenth, rad (norm over joints).
        pairs: Number of pairs in that tenth.
        systematic: Whether neighbours agree clearly better than chance: the rest depends on posture.
    """

    seen: float
    closest: float
    distance: float
    pairs: int
    systematic: bool


def compare_neighbours(q: Float2D, residual: Float2D, point: Int1D, configuration: Int1D) -> Neighbours | None:
    """Compare every residual with that of the nearest posture of another configuration, same point.

    The ratio of the two variances is 1 for white noise, with a variance of at most 2 / (3 m) (von Neumann's ratio).

    Args:
        q: (m, n) rad.
        residual: (3, m) m.
        point: (m,) measurement point.
        configuration: (m,) configuration.

    Returns:
        None with fewer than 50 readings.
    """
    if len(q) < ENOUGH:
        return None
    from scipy.spatial import cKDTree  # slow to load, and loaded recordings do not need it

    squares, distances = [], []
    for number in np.unique(point):
        rows = np.flatnonzero(point == number)
        if len(rows) < 2:
            continue
        distance, index = cKDTree(q[rows]).query(q[rows], k=2)
        other = rows[index[:, 1]]
        apart = (configuration[other] != configuration[rows]) & np.isfinite(distance[:, 1])
        squares.append(np.sum((residual[:, rows] - residual[:, other])[:, apart] ** 2, axis=0) / 6)
        distances.append(distance[apart, 1])
    square, distance = np.concatenate(squares), np.concatenate(distances)
    if len(square) < ENOUGH:
        return None
    total = float(np.mean(residual**2))
    ratio = float(square.mean()) / total if total > 0 else 1.0
    limit = float(np.quantile(distance, CLOSEST))
    close = distance <= limit
    return Neighbours(
        seen=float(np.sqrt(square.mean())),
        closest=float(np.sqrt(square[close].mean())),
        distance=limit,
        pairs=int(close.sum()),
        systematic=(1 - ratio) > CLEAR * float(np.sqrt(2 / (3 * len(square)))),
    )


def audit_absolute(
    noise: Float3D,
    checks: tuple[NoiseCheck | None, ...],
    neighbours: Neighbours | None,
    chi2: float,
    freedom: int,
) -> NoiseAudit:
    """Compare the claimed noise with the residual, and say whether the rest is noise at all.

    Args:
        noise: (m, 3, 3) m^2, claimed covariances of the readings used.
        checks: Further ways the noise was seen, see `noise_audit`.
        neighbours: Residuals of neighbouring postures; None if too few.
        chi2: Weighted sum of squares of the fit.
        freedom: Its degrees of freedom.
    """
    plain = audit(noise, checks, chi2, freedom)
    if neighbours is None:
        return plain
    repeats = neighbours.distance <= REPEATED
    seen = NoiseCheck(REPEATS if repeats else NEIGHBOURS, neighbours.closest, 3 * neighbours.pairs)
    with_neighbours = dataclasses.replace(plain, checks=(*plain.checks, seen))
    if plain.scale == 1.0 or not neighbours.systematic:
        return with_neighbours
    share = 1 - min(neighbours.closest / (plain.claimed * plain.scale), 1.0) ** 2
    left, closest = plain.claimed * plain.scale * 1e6, neighbours.closest * 1e6
    text = (
        f"{plain.claimed * 1e6:.1f} µm per coordinate claimed, {left:.1f} µm left by the model. "
        f"The closest {seen.source} "
        f"(within {_angle(neighbours.distance)}) differ by {closest:.1f} µm only: the noise is not larger than that, "
        f"and at least {100 * share:.0f} % of the variance left depends on posture: the model leaves something out. "
        "The standard deviations treat it as independent from pose to pose and are rather too small."
    )
    others = any(check.source == TRIANGLE for check in plain.checks) and plain.understated
    understated = others or (repeats and rejects(seen, plain.claimed))
    if understated:
        text += " The readings scatter more than claimed all the same."
    return dataclasses.replace(with_neighbours, understated=understated, text=text)


def _angle(size: float) -> str:
    """Return an angle, rad, with two significant digits and a unit in which it is read without an exponent."""
    if size < 1e-7:
        return "0.1 µrad"
    factor, unit = (1.0, "rad") if size >= 1.0 else (1e3, "mrad") if size >= 1e-3 else (1e6, "µrad")
    value = float(f"{size * factor:.1e}")
    return f"{value:.0f} {unit}" if value >= 10 else f"{value:.1f} {unit}"
