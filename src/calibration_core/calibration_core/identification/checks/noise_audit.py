"""Claimed against seen noise, first without any model."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from calibration_core.identification.result.estimate import (
    MODEL_FREE,
    TRIANGLE,
    Anomaly,
    Exclusion,
    NoiseAudit,
    NoiseCheck,
)
from calibration_core.identification.statistics import LEVEL, chi2_limit
from calibration_core.input_checks.loaded import MANY, OVERSTATED, overstated_words
from calibration_core.observations.average import coordinate_std
from calibration_core.policy import MAD, OTHERS, UNUSUAL
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


def out_of_shape(readings: Readings, noise: float) -> Bool1D:
    """Return the (m,) readings whose distances to all other points of their step, two or more, are not the usual ones.

    No model of the robot is needed: whatever moves the tool keeps its shape.

    Args:
        readings: m readings, absolute positions.
        noise: Claimed standard deviation of one coordinate, m.
    """
    keys = np.column_stack([readings.configuration, readings.step])
    steps, row = np.unique(keys, axis=0, return_inverse=True)
    table = np.full((len(steps), len(readings.points), 3), np.nan)
    table[row.reshape(-1), readings.point] = readings.position
    distance = np.linalg.norm(table[:, :, None] - table[:, None], axis=-1)
    change = np.full_like(distance, np.nan)
    for i, j in itertools.permutations(np.unique(readings.point), 2):
        seen = np.isfinite(distance[:, i, j])
        if seen.any():
            change[:, i, j] = np.abs(distance[:, i, j] - np.median(distance[seen, i, j]))
    known = np.isfinite(change)
    usual = max(np.sqrt(2) * noise, MAD * float(np.median(change[known]))) if known.any() else np.inf
    off = (change > UNUSUAL * usual).sum(axis=2)
    gross = (off == known.sum(axis=2)) & (off >= OTHERS)
    return np.asarray(gross[row.reshape(-1), readings.point])


# --- what is wrong with the data and no physics of the robot, as far as an identification notices it ------------------


OUTLIERS = "outlier_readings"
NAMED = 12  # readings that a text names


def exclusion(readings: Readings, row: int, reason: str, size: float, squared: float) -> Exclusion:
    """Name a reading that is not used: its row, why, the length of its residual, m, and its square in variances."""
    place = int(readings.configuration[row]), int(readings.step[row]), readings.points[readings.point[row]]
    return Exclusion(*place, reason=reason, size=float(size), times_sigma=math.sqrt(squared))


def outlier_text(keys: Sequence[tuple[int, int, str]], size: float, beside: str) -> str:
    """Say how many readings are set aside, and which.

    Args:
        keys: Configuration, step and point of each.
        size: The largest residual, m.
        beside: What they do not fit.
    """
    named = ", ".join("/".join(map(str, key)) for key in keys[:NAMED])
    more = f" and {len(keys) - NAMED} more" if len(keys) > NAMED else ""
    count, unused = (
        ("1 reading does", "it is not used") if len(keys) == 1 else (f"{len(keys):,} readings do", "they are not used")
    )
    return f"{count} not fit {beside} (configuration/step/point {named}{more}), by up to {1e3 * size:.2f} mm; {unused}."


def with_own_outliers(anomalies: Sequence[Anomaly], own: Sequence[Anomaly]) -> tuple[Anomaly, ...]:
    """Return the anomalies of a search, outliers as the identification itself sets them aside, where it does."""
    outliers = [one for one in own if one.kind == OUTLIERS]
    if not outliers or all(one.kind != OUTLIERS for one in anomalies):
        return tuple(anomalies)
    first = next(k for k, one in enumerate(anomalies) if one.kind == OUTLIERS)
    others = [one for one in anomalies[first:] if one.kind != OUTLIERS]
    return (*anomalies[:first], *outliers, *others)


def outliers_of(exclusions: Sequence[Exclusion]) -> tuple[Anomaly, ...]:
    """Return the anomaly of readings that are not used, in the order of time; none where all are."""
    if not exclusions:
        return ()
    largest = max(exclusions, key=lambda exclusion: exclusion.size)
    where: dict[str, str | int] = {
        "point": largest.point,
        "configuration": largest.configuration,
        "step": largest.step,
    }
    keys = [(one.configuration, one.step, one.point) for one in exclusions]
    text = outlier_text(keys, largest.size, "the others")
    return (Anomaly(OUTLIERS, where, (keys[0][0], keys[-1][0]), largest.size, "m", text),)


def overstated(noise: NoiseAudit) -> tuple[Anomaly, ...]:
    """Return the anomaly of positions at rest that scatter far less than is claimed; loads are looked at before."""
    left = noise.left
    if left.degrees_of_freedom < MANY or left.seen > OVERSTATED * noise.claimed:
        return ()
    text, remedy = overstated_words("the fit leaves", left.seen, noise.claimed)
    return (Anomaly("noise_overstated", {"tracker": "tracker"}, None, left.seen, "m", text, remedy),)


def anomalies_of(noise: NoiseAudit, exclusions: Sequence[Exclusion], readings: Readings) -> tuple[Anomaly, ...]:
    """Return understated noise, excluded readings and unsettled plateaus."""
    found = []
    if noise.understated:
        seen = noise.seen_without_model or noise.claimed * noise.scale
        found.append(Anomaly("noise_understated", {"instrument": "tracker"}, None, seen, "m", noise.text))
    found += outliers_of(exclusions)
    unsettled = [note for note in readings.notes if note.kind == "unsettled"]
    found += [Anomaly("unsettled", {"place": n.place}, None, float(n.count), "1", n.text) for n in unsettled]
    return tuple(found)
