"""Gross errors among absolute positions: single mis-measured poses, found one at a time and named.

What a model leaves out is not an outlier.  A reading is judged against the recording's own scatter, heavy tails
included, never against the instrument's claim; it is excluded only where it stands apart from all the others.

What is left after the fit of absolute positions: noise, or something that depends on posture?

Neighbouring postures share almost everything that depends on posture, but not their noise.  Differences of residuals
between neighbours therefore bound the noise from above, without any model of what is missing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.identification.checks.noise_audit import audit, rejects
from calibration_core.identification.geometry.fit import (
    AbsoluteProblem,
    GeometryFit,
    NormalEquations,
    Prior,
    bounded_step,
    fit,
    lower_steps,
    whitened,
)
from calibration_core.identification.geometry.terms import Term
from calibration_core.identification.result.estimate import REPEATS, TRIANGLE, NoiseAudit, NoiseCheck
from calibration_core.identification.statistics import chi2_limit, f_limit
from calibration_core.model.parameters import ModelParameters
from calibration_core.policy import FALSE_EXCLUSION, MOST_EXCLUDED_AT_REST, TAKEN_BACK
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D

MARGIN = 1.25  # on top of the quantile: tails of a systematic rest
LEVERAGE = 0.05  # readings whose own leverage leaves less than this of a direction cannot be judged
ROUNDS = 5
Linearised = tuple[Float3D, Float2D]


@dataclasses.dataclass(frozen=True, eq=False)
class GrossErrorRejection:
    """A fit without gross errors.

    Attributes:
        fit: The fit to the readings used.
        used: (m,) mask.
        squared: (m,) squared residual of every reading predicted from the others, in units of its claimed covariance.
        threshold: Limit on `squared`.
        full: Whether the search stopped because the allowed share was reached.
    """

    fit: GeometryFit
    used: Bool1D
    squared: Float1D
    threshold: float
    full: bool


def reject_gross_errors(
    problem: AbsoluteProblem,
    start: ModelParameters,
    terms: Sequence[Term],
    used: Bool1D,
    protected: Bool1D,
    prior: Prior | None = None,
    beyond: int = 0,
) -> GrossErrorRejection:
    """Fit, take out gross errors one at a time, refit, and take back what fits after all.

    The statistic of a reading is its deletion residual e^T (I - H)^-1 e.  Its scale is the larger of what the median
    and the 90 % quantile of all readings say under normal errors, so that a heavy-tailed rest widens the limit; the
    limit is the F quantile that a clean recording exceeds anywhere with 1 % probability, times 1.25^2.  Between
    exclusions the solution is updated in the linearised problem; when none is left the fit is repeated and the search
    goes on.

    Args:
        problem: All readings.
        start: First guess.
        terms: What is fitted.
        used: (m,) readings to begin with.
        protected: (m,) readings that must be used whatever they look like.
        prior: What is known of the terms already.
        beyond: Readings that are wrong by no model, which do not count towards the share allowed.
    """
    budget = beyond + max(1, int(MOST_EXCLUDED_AT_REST * len(problem)))
    used = used | protected
    result, squared, threshold, linear = _judge(problem, start, terms, used, prior)
    for _ in range(ROUNDS):
        found = _exclude(linear, result, used, protected, budget)
        back = ~used & (squared < TAKEN_BACK * threshold)
        if not found.any() and not back.any():
            break
        used = (used & ~found) | back
        result, squared, threshold, linear = _judge(problem, result.parameters, terms, used, prior)
    return GrossErrorRejection(result, used, squared, threshold, full=int(np.sum(~used)) >= budget)


def _judge(
    problem: AbsoluteProblem, start: ModelParameters, terms: Sequence[Term], used: Bool1D, prior: Prior | None
) -> tuple[GeometryFit, Float1D, float, Linearised]:
    """Fit the readings used and judge all of them; return what they are linear in, too."""
    result = fit(problem.select(np.flatnonzero(used)), start, terms, prior)
    columns, residual = _linearised(problem, result)
    squared = np.empty(len(problem))
    squared[used] = _deletion(columns[:, :, used], residual[:, used], result.normal, sign=-1.0)
    squared[~used] = _deletion(columns[:, :, ~used], residual[:, ~used], result.normal, sign=1.0)
    return result, squared, _threshold(squared[used], len(problem), result.freedom), (columns, residual)


def _exclude(linear: Linearised, result: GeometryFit, used: Bool1D, protected: Bool1D, budget: int) -> Bool1D:
    """Return the readings to exclude, found one at a time in the problem linearised at `result`."""
    columns, residual = linear
    normal, left, e = result.normal, used.copy(), residual
    found = np.zeros(len(used), dtype=bool)
    lower = lower_steps(result.terms, result.parameters)
    while int(np.sum(~left)) < budget:
        squared = np.where(left, _deletion(columns, e, normal, sign=-1.0), 0.0)
        threshold = _threshold(squared[left], len(left), 3 * normal.readings - len(normal.gradient))
        worst = int(np.argmax(np.where(protected, 0.0, squared)))
        if protected[worst] or squared[worst] <= threshold:
            break
        left[worst], found[worst] = False, True
        own = NormalEquations(
            columns[:, :, worst] @ columns[:, :, worst].T,
            columns[:, :, worst] @ residual[:, worst],
            float(residual[:, worst] @ residual[:, worst]),
            1,
        )
        normal = normal - own
        e = residual - np.tensordot(bounded_step(normal, lower), columns, axes=1)
    return found


def _linearised(problem: AbsoluteProblem, result: GeometryFit) -> Linearised:
    """Return fully whitened columns (p, 3, m) and residuals (3, m)."""
    parts = [whitened(block, result.parameters, result.terms) for block in problem.blocks()]
    weight = problem.whitening if isinstance(problem.whitening, float) else 1.0
    columns = weight * np.concatenate([part[0] for part in parts], axis=2)
    return columns, weight * np.concatenate([part[1] for part in parts], axis=1)


def _deletion(columns: Float3D, residual: Float2D, normal: NormalEquations, sign: float) -> Float1D:
    """Return e^T (I + sign H)^-1 e of each reading, (m,), H = J N^-1 J^T its leverage; 0 where it cannot be judged."""
    p, _, m = columns.shape
    if m == 0:
        return np.empty(0)
    scale = 1.0 / np.sqrt(np.diag(normal.matrix))
    lower = np.linalg.cholesky(normal.matrix * np.outer(scale, scale) + 1e-13 * np.eye(p))
    reduced = ((np.linalg.inv(lower) * scale) @ columns.reshape(p, -1)).reshape(p, 3, m)
    system = np.eye(3) + sign * np.einsum("pam,pbm->mab", reduced, reduced)
    values, vectors = np.linalg.eigh(system)
    along = np.einsum("mab,am->mb", vectors, residual)
    known = values[:, 0] > LEVERAGE
    return np.where(known, np.sum(along**2 / np.maximum(values, LEVERAGE), axis=1), 0.0)


def _threshold(squared: Float1D, readings: int, freedom: int) -> float:
    known = squared[squared > 0]
    if len(known) < 4 or freedom < 4:
        return np.inf
    scale = max(float(np.quantile(known, level)) / chi2_limit(1 - level, 3) for level in (0.5, 0.9))
    return MARGIN**2 * scale * 3 * f_limit(FALSE_EXCLUSION / readings, 3, freedom)


# --- what is left after the fit of absolute positions -----------------------------------------------------------------


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
