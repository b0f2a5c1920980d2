"""What remains of absolute positions after the findings: noise, or something with a place."""

from __future__ import annotations

import numpy as np

from calibration_core.diagnosis.absolute_design import AbsoluteDesign
from calibration_core.diagnosis.absolute_fit import AbsoluteExtended
from calibration_core.diagnosis.blocks import Blocks
from calibration_core.diagnosis.finding import Rest
from calibration_core.diagnosis.left_out import left_out
from calibration_core.identification.distributions import f_tail
from calibration_core.identification.estimate import NoiseAudit
from calibration_core.identification.rest import compare_neighbours
from calibration_core.model.effects.transmission_error import order_of
from calibration_core.timeseries import Readings

SIGNIFICANT = 0.001
SMALLEST_EXCESS = 1.05  # of the noise: a smaller rest does not matter, however certain
MISSTATED = 1.5  # factor by which an instrument's claim may be wrong where nothing else shows the noise
TRUSTED_FREEDOM = 60  # degrees of freedom from which on the rigid triangle shows the noise
ORDERS = 24  # of a joint's angle, to say how much of the rest follows it
SHRINK = 1e-2  # ridge of those, columns of length one
LEAST_SHARE = 0.03  # of the rest, to be mentioned
WORST = 5


def what_remains_absolute(
    extended: AbsoluteExtended,
    design: AbsoluteDesign,
    accepted: tuple[int, ...],
    partition: Blocks,
    readings: Readings,
    noise: NoiseAudit,
) -> Rest:
    """Compare the rest with the noise as the recording shows it, and say which joints' angles it follows.

    The noise is taken from the rigid triangle of several points; else from neighbouring postures, which share what
    depends on posture; else from the instrument's claim, which may be wrong by half.

    Args:
        extended: The fit of everything found.
        design: The search's linear model.
        accepted: What was found, in it.
        partition: Of the design's readings.
        readings: The recording.
        noise: The audit of the null model.
    """
    used = extended.used
    residual = extended.residual
    variance = float(np.mean(residual[used] ** 2))
    freedom = max(3 * int(used.sum()) - extended.columns.shape[1], 1)
    variance *= 3 * int(used.sum()) / freedom
    floor, significant = _floor(extended, readings, noise, variance, freedom)
    excess = float(np.sqrt(max(variance - floor**2, 0.0)))
    if not significant:
        return Rest(excess, False, {}, "What remains agrees with the noise.")
    shares = _followed(design, accepted, partition)
    length = np.linalg.norm(residual, axis=1) * used
    worst = [int(readings.configuration[k]) for k in np.argsort(-length)[:WORST]]
    where: dict[str, object] = {"joints": shares, "configurations": worst}
    text = (
        f"{1e6 * np.sqrt(variance):.0f} µm per coordinate remain, of which {1e6 * excess:.0f} µm are more than noise "
        f"({1e6 * floor:.0f} µm) and unexplained."
    )
    if shares:
        listed = ", ".join(f"{joint} ({100 * share:.0f} %)" for joint, share in shares.items())
        text += f" They follow the angle of {listed} in ways that no single term carries; the rest is not located."
    else:
        text += " No single joint's angle explains them."
    return Rest(excess, True, where, text)


def _floor(
    extended: AbsoluteExtended, readings: Readings, noise: NoiseAudit, variance: float, freedom: int
) -> tuple[float, bool]:
    """Return the noise, m per coordinate, and whether the rest is significantly more."""
    triangle = next((check for check in noise.checks if check.source == "rigid triangle"), None)
    if triangle is not None and triangle.degrees_of_freedom >= TRUSTED_FREEDOM and triangle.seen > 0:
        return triangle.seen, _exceeds(variance, triangle.seen, freedom, triangle.degrees_of_freedom)
    used = extended.used
    neighbours = compare_neighbours(
        readings.q[used], extended.residual[used].T, readings.point[used], readings.configuration[used]
    )
    if neighbours is not None:
        floor = min(neighbours.closest, float(np.sqrt(variance)))
        return floor, neighbours.systematic and np.sqrt(variance) > SMALLEST_EXCESS * floor
    claimed = MISSTATED * noise.claimed
    return claimed, _exceeds(variance, claimed, freedom, 10**6)


def _exceeds(variance: float, noise: float, freedom: int, noise_freedom: int) -> bool:
    ratio = variance / noise**2
    chance = f_tail(ratio, freedom, noise_freedom)
    return bool(chance < SIGNIFICANT and np.sqrt(ratio) > SMALLEST_EXCESS)


def _followed(design: AbsoluteDesign, accepted: tuple[int, ...], partition: Blocks) -> dict[str, float]:
    """Return joint -> share of the rest, on blocks left out, that any smooth function of its angle explains."""
    base = design.of(accepted)
    before = float((left_out(base, design.residual, partition) ** 2).sum())
    shares: dict[str, float] = {}
    for joint in dict.fromkeys(str(c.location.get("joint")) for c in design.candidates if _wave(c.effect)):
        members = [
            i
            for i, c in enumerate(design.candidates)
            if _wave(c.effect) and c.location["joint"] == joint and i not in accepted and order_of(c.variant) <= ORDERS
        ]
        waves = np.concatenate([design.columns[:, design.blocks[i]] for i in members], axis=1) if members else None
        if waves is None:
            continue
        length = np.linalg.norm(waves, axis=0)
        waves = waves[:, length > 0] / length[length > 0]
        wide = np.concatenate([base, waves], axis=1)
        ridge = np.concatenate([np.zeros(base.shape[1]), np.full(waves.shape[1], SHRINK)])
        after = float((left_out(wide, design.residual, partition, ridge=ridge) ** 2).sum())
        share = 1 - after / before
        if share > LEAST_SHARE:
            shares[joint] = round(share, 3)
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _wave(effect: str) -> bool:
    return effect == "transmission_error"
