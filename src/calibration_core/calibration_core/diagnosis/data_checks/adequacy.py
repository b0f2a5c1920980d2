"""Is what remains noise?  Held against what shows noise without a model, never against the misfit itself."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from calibration_core.diagnosis.result.finding import Rest
from calibration_core.estimation.estimate import Estimate
from calibration_core.estimation.hypotheses import WAVE
from calibration_core.identification.checks.noise_audit import rigid_triangle
from calibration_core.identification.statistics.beyond_noise import FINEST, beyond_noise
from calibration_core.timeseries import Bool1D, Readings

MISSTATED = 1.5  # factor by which an instrument's claim may be wrong where nothing else shows the noise
TRUSTED = 60  # degrees of freedom from which on the rigid triangle shows the noise
SHARED = 1.0  # of the own noise, that all points of a step may share unseen by the triangle
WORST = 5
NOTHING = "The residual agrees with the noise."


def against_noise(
    seen: float, freedom: float, noise: float, noise_freedom: float, per: Mapping[int, float], name: str = "noise"
) -> Rest:
    """Compare a residual with the noise, and say where it is largest.

    Args:
        seen: Standard deviation of one coordinate of the residual, m.
        freedom: Its degrees of freedom.
        noise: Standard deviation of one coordinate of the noise, m.
        noise_freedom: Degrees of freedom from which it is known; infinity: it is stated.
        per: Number of a configuration -> rms of one coordinate of its residual, m.
        name: What `noise` is, in words.
    """
    excess, significant = beyond_noise(seen, freedom, noise, noise_freedom)
    if not significant:
        return Rest(excess, False, {}, NOTHING)
    worst = sorted(per, key=lambda number: -per[number])[:WORST]
    where = {"configurations": worst, "times_noise": [round(per[number] / noise, 2) for number in worst]}
    text = (
        f"{1e6 * seen:.1f} µm per coordinate remain, of which {1e6 * excess:.1f} µm are more than {name} "
        f"({1e6 * noise:.1f} µm) and not explained; they are largest in configurations {', '.join(map(str, worst))}."
    )
    return Rest(excess, True, where, text)


def what_remains(found: Estimate, readings: Readings, claimed: float) -> Rest:
    """Compare the residual of the extended model with the noise.

    Args:
        found: The estimate.
        readings: The recording.
        claimed: Standard deviation of one coordinate, as the instruments claim it, m.
    """
    extended = found.extended
    used = extended.model.used
    freedom = max(3 * int(used.sum()) - extended.flat, 1)
    shared = extended.whitening.shared
    seen = claimed * float(np.sqrt(extended.variance * (1 + shared**2)))
    squares = np.sum(extended.left**2, axis=1) * used
    numbers, index = np.unique(readings.configuration, return_inverse=True)
    mean = np.bincount(index.reshape(-1), squares) / np.bincount(index.reshape(-1))
    per = dict(zip(numbers.tolist(), np.sqrt(mean / 3).tolist(), strict=True))
    floor, known = noise_floor(readings, used, claimed, shared)
    name = "noise" if math.isfinite(known) else f"{MISSTATED:g} times the stated noise"
    rest = against_noise(seen, freedom, floor, known, per, name)
    if not rest.significant:
        return rest
    return dataclasses.replace(rest, where={**rest.where, "joints": followed(found)})


def noise_floor(readings: Readings, used: Bool1D, claimed: float, shared: float) -> tuple[float, float]:
    """Return the noise, m per coordinate, and the degrees of freedom from which it is known.

    From the rigid triangle of several points, which shows a reading's own noise; what the points of a step share comes
    on top, up to as much again.  Else from the claim, which may be wrong by half.
    """
    triangle = rigid_triangle(readings.position, readings, used)
    if triangle is None or triangle.degrees_of_freedom < TRUSTED or triangle.seen <= 0:
        return MISSTATED * claimed, math.inf
    own = max(triangle.seen, FINEST * claimed)
    return own * float(np.sqrt(1 + min(shared, SHARED) ** 2)), triangle.degrees_of_freedom


def followed(found: Estimate) -> dict[str, float]:
    """Return joint -> share of what is left that low harmonics of its angle explain, as far as they convince."""
    search, hypotheses = found.search, found.offered.hypotheses
    scores = search.scores(found.selection.accepted)
    shares: dict[str, float] = {}
    for i, k in search.place.items():
        one = hypotheses[i]
        if one.effect == WAVE and "joint" in one.location and scores.nats[k] > search.limit:
            trial = search.trial(found.selection.accepted, i)
            joint, share = str(one.location["joint"]), max(p.share for p in trial.proofs)
            if share > max(shares.get(joint, 0.0), 0.0):
                shares[joint] = round(share, 3)
    return dict(sorted(shares.items(), key=lambda item: -item[1]))
