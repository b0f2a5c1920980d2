"""Is what remains noise?  Held against what shows noise without a model, never against the misfit itself."""

from __future__ import annotations

import numpy as np

from calibration_core.diagnosis.result.finding import Rest
from calibration_core.estimation.estimate import Estimate
from calibration_core.identification.checks.noise_audit import rigid_triangle
from calibration_core.identification.statistics.distributions import f_tail
from calibration_core.timeseries import Bool1D, Readings

SIGNIFICANT = 0.001
SMALLEST_EXCESS = 1.05  # of the noise: a smaller residual does not matter, however certain
MISSTATED = 1.5  # factor by which an instrument's claim may be wrong where nothing else shows the noise
TRUSTED = 60  # degrees of freedom from which on the rigid triangle shows the noise
SHARED = 1.0  # of the own noise, that all points of a step may share unseen by the triangle
WORST = 5


def what_remains(found: Estimate, readings: Readings, claimed: float) -> Rest:
    """Compare the residual of the extended model with the noise.

    Args:
        found: The estimate.
        readings: The recording.
        claimed: Standard deviation of one coordinate, as the instruments claim it, m.
    """
    extended = found.extended
    used = extended.model.used
    residual = extended.left
    freedom = max(3 * int(used.sum()) - extended.flat, 1)
    shared = extended.whitening.shared
    variance = claimed**2 * extended.variance * (1 + shared**2)
    floor, noise_freedom = noise_floor(readings, used, claimed, shared)
    excess = float(np.sqrt(max(variance - floor**2, 0.0)))
    tail = f_tail(variance / floor**2, freedom, noise_freedom)
    if not (tail < SIGNIFICANT and np.sqrt(variance) > SMALLEST_EXCESS * floor):
        return Rest(excess, False, {}, "The residual agrees with the noise.")
    length = np.linalg.norm(residual, axis=1) * used
    numbers = np.unique(readings.configuration)
    per = np.array([float(np.sqrt(np.mean(length[readings.configuration == n] ** 2) / 3)) for n in numbers])
    worst = np.argsort(-per)[:WORST]
    where: dict[str, object] = {
        "configurations": [int(numbers[k]) for k in worst],
        "times_noise": [round(float(per[k]) / floor, 2) for k in worst],
        "joints": followed(found),
    }
    text = (
        f"{1e6 * np.sqrt(variance):.0f} µm per coordinate remain, of which {1e6 * excess:.0f} µm are more than noise "
        f"({1e6 * floor:.0f} µm) and unexplained; largest in configurations "
        f"{', '.join(str(int(numbers[k])) for k in worst)}."
    )
    return Rest(excess, True, where, text)


def noise_floor(readings: Readings, used: Bool1D, claimed: float, shared: float) -> tuple[float, int]:
    """Return the noise, m per coordinate, and the degrees of freedom from which it is known.

    From the rigid triangle of several points, which shows a reading's own noise; what the points of a step share comes
    on top, up to as much again.  Else from the claim, which may be wrong by half.
    """
    triangle = rigid_triangle(readings.position, readings, used)
    if triangle is None or triangle.degrees_of_freedom < TRUSTED or triangle.seen <= 0:
        return MISSTATED * claimed, 10**6
    return triangle.seen * float(np.sqrt(1 + min(shared, SHARED) ** 2)), triangle.degrees_of_freedom


def followed(found: Estimate) -> dict[str, float]:
    """Return joint -> share of what is left that low harmonics of its angle explain, as far as they convince."""
    search, hypotheses = found.search, found.offered.hypotheses
    scores = search.scores(found.selection.accepted)
    shares: dict[str, float] = {}
    for i, k in search.place.items():
        one = hypotheses[i]
        if one.effect == "transmission_error" and "joint" in one.location and scores.nats[k] > search.limit:
            trial = search.trial(found.selection.accepted, i)
            joint, share = str(one.location["joint"]), max(p.share for p in trial.proofs)
            if share > max(shares.get(joint, 0.0), 0.0):
                shares[joint] = round(share, 3)
    return dict(sorted(shares.items(), key=lambda item: -item[1]))
