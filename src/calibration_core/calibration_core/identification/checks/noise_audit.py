"""Claimed against seen noise, first without any model."""

from __future__ import annotations

import numpy as np

from calibration_core.identification.result.estimate import MODEL_FREE, TRIANGLE, NoiseAudit, NoiseCheck
from calibration_core.identification.statistics.distributions import LEVEL, chi2_limit
from calibration_core.observations.covariance import coordinate_std
from calibration_core.timeseries import Bool1D, Float2D, Float3D, Int1D, Readings

UNLOADED_FORCE = 0.02  # steps below this share of the largest force count as unloaded


def rigid_triangle(position: Float2D, readings: Readings, used: Bool1D) -> NoiseCheck | None:
    """See the noise in the shape of three or more points on a rigid tool: it must not change.

    Every step's points are laid on their mean shape by the best rigid motion; 3 k - 6 coordinates of k points are left.
    (Loads and the robot move the tool, not its shape.)

    Args:
        position: (m, 3) m, any fixed frame.
        readings: For the grouping into steps.
        used: (m,) readings to look at.

    Returns:
        None where no step has three points.  Of several recordings, each with a shape of its own, one figure for all.
    """
    if readings.recording is None:
        return _triangle(position, readings, used, np.arange(len(readings.points)))
    each = [readings.recording == number for number in np.unique(readings.recording)]
    found = [_triangle(position[r], readings.select(r), used[r], np.unique(readings.point[r])) for r in each]
    seen = [check for check in found if check is not None]
    if not seen:
        return None
    freedom = sum(check.degrees_of_freedom for check in seen)
    claimed = [_claimed(readings, r) if check is not None else 1.0 for r, check in zip(each, found, strict=True)]
    squares = sum(
        (check.seen / claim) ** 2 * check.degrees_of_freedom
        for check, claim in zip(found, claimed, strict=True)
        if check is not None
    )
    return NoiseCheck(TRIANGLE, _claimed(readings, used) * float(np.sqrt(squares / freedom)), freedom)


def _claimed(readings: Readings, rows: Bool1D) -> float:
    """Return the standard deviation per coordinate that the instruments of several recordings claim, m."""
    assert readings.position_claim is not None  # noqa: S101 - every recording brings its own
    return coordinate_std(readings.position_claim[rows])


def _triangle(position: Float2D, readings: Readings, used: Bool1D, points: Int1D) -> NoiseCheck | None:
    """See the noise in the shape of these points (their indices)."""
    k = len(points)
    if k < 3:
        return None
    keys = np.column_stack([readings.configuration, readings.step])[used]
    _, owner = np.unique(keys, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    steps = int(owner.max()) + 1 if len(owner) else 0
    table = np.full((steps, k, 3), np.nan)
    table[owner, np.searchsorted(points, readings.point[used])] = position[used]
    table = table[np.isfinite(table).all(axis=(1, 2))]
    if len(table) < 2:
        return None
    shape = table[0] - table[0].mean(axis=0)
    for _ in range(3):
        fitted = _laid_on(shape, table)
        shape = fitted.mean(axis=0)
        shape = shape - shape.mean(axis=0)
    rest = _laid_on(shape, table) - shape
    freedom = (len(table) - 1) * (3 * k - 6)
    return NoiseCheck(TRIANGLE, float(np.sqrt((rest**2).sum() / freedom)), freedom)


def zero_return(residual: Float2D, readings: Readings, used: Bool1D) -> NoiseCheck | None:
    """See noise and lost motion in the difference between the first and last unloaded reading of a configuration.

    Args:
        residual: (m, 3) m, measured - predicted, offsets not removed.
        readings: For the grouping.
        used: (m,) readings to look at.

    Returns:
        None where no configuration returns to zero load.  The figure contains hysteresis and creep of the robot.
    """
    if readings.wrench is None:
        return None
    force = np.linalg.norm(readings.wrench[:, :3], axis=1)
    zero = used & (force <= UNLOADED_FORCE * force.max(initial=0.0))
    squares, pairs = 0.0, 0
    keys = np.column_stack([readings.configuration, readings.point])
    for key in np.unique(keys[zero], axis=0):
        rows = np.flatnonzero(zero & (keys == key).all(axis=1))
        if len(rows) > 1:
            first, last = rows[np.argmin(readings.step[rows])], rows[np.argmax(readings.step[rows])]
            squares += float(((residual[last] - residual[first]) ** 2).sum()) / 2
            pairs += 1
    return NoiseCheck("zero return", float(np.sqrt(squares / (3 * pairs))), 3 * pairs) if pairs else None


def window_scatter(readings: Readings, used: Bool1D) -> NoiseCheck | None:
    """See the noise of one averaged reading in the scatter within its own window (bags only)."""
    if readings.position_covariance is None or readings.samples is None or not used.any():
        return None
    variance = np.einsum("mii->m", readings.position_covariance[used]) / 3
    freedom = int(3 * np.maximum(readings.samples[used] - 1, 0).sum())
    return NoiseCheck("window scatter", float(np.sqrt(variance.mean())), freedom) if freedom else None


def audit(noise: Float3D, checks: tuple[NoiseCheck | None, ...], chi2: float, freedom: int) -> NoiseAudit:
    """Compare the claim with what was seen, and say by how much the uncertainties must grow.

    Args:
        noise: (m, 3, 3) m^2, claimed covariances of the readings used.
        checks: What was seen without, or beside, the model; None where it could not be seen.
        chi2: Weighted sum of squares of the fit.
        freedom: Its degrees of freedom.
    """
    claimed = coordinate_std(noise)
    ratio = float(np.sqrt(chi2 / freedom)) if freedom > 0 else 1.0
    present = [check for check in checks if check is not None]
    rest = NoiseCheck("residual", claimed * ratio, freedom)
    model_free = [check for check in present if check.source in MODEL_FREE]
    rejected = {check.source for check in (*model_free, rest) if rejects(check, claimed)}
    understated = bool(rejected - {"residual"}) if model_free else "residual" in rejected
    scale = ratio if "residual" in rejected else 1.0
    return NoiseAudit(
        claimed, (*present, rest), max(scale, 1.0), understated, _text(claimed, rest, model_free, rejected)
    )


def rejects(check: NoiseCheck, claimed: float) -> bool:
    """Say whether what was seen is more than the claim, m, explains (1 % level)."""
    squares = check.degrees_of_freedom * (check.seen / claimed) ** 2
    return bool(check.degrees_of_freedom > 0 and squares > chi2_limit(LEVEL, check.degrees_of_freedom))


def _text(claimed: float, rest: NoiseCheck, model_free: list[NoiseCheck], rejected: set[str]) -> str:
    claim = f"The cell file states {claimed * 1e6:.1f} µm per coordinate"
    seen = "; ".join(f"{check.source} {check.seen * 1e6:.1f} µm" for check in (*model_free, rest))
    if not rejected:
        return f"{claim}; the recording shows: {seen}. What is stated holds."
    if rejected == {"residual"} and model_free:
        return (
            f"{claim}; the recording shows: {seen}. The instrument is as good as stated; the model leaves a "
            "residual that noise does not explain, and the uncertainties are widened by it."
        )
    if rejected == {"residual"}:
        return (
            f"{claim}; the recording shows: {seen}. The claimed noise does not explain the residual: the "
            "noise is larger than claimed, or the model leaves something out; one point without repeats cannot show "
            "which. The uncertainties are widened by it."
        )
    return f"{claim}; the recording shows: {seen}. The noise is larger than claimed."


def _laid_on(shape: Float2D, table: Float3D) -> Float3D:
    """Return every step's points after the best rigid motion onto `shape` (Kabsch, 1976)."""
    centred = table - table.mean(axis=1, keepdims=True)
    u, _, vt = np.linalg.svd(np.einsum("skj,ki->sji", centred, shape))
    sign = np.linalg.det(u @ vt)
    u[:, :, -1] *= sign[:, None]
    return centred @ (u @ vt)
