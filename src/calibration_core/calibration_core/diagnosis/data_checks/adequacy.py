"""Is what remains noise?  Held against what shows noise without a model, never against the misfit itself."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.diagnosis.result.finding import Rest
from calibration_core.estimation.estimate import Estimate
from calibration_core.estimation.hypotheses import WAVE
from calibration_core.estimation.shifts import FAMILY, around
from calibration_core.identification.checks.noise_audit import rigid_triangle
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.identification.statistics import FINEST, beyond_noise, rms_length
from calibration_core.model.effects.candidate import number_of
from calibration_core.model.effects.words import listed_location
from calibration_core.policy import EQUIVALENT
from calibration_core.timeseries import Bool1D, Readings, in_time

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


NEAR = 3  # configurations within which two steps are one


def shift_anomalies(found: Estimate, readings: Readings) -> tuple[Anomaly, ...]:
    """Return the steps that were accepted."""
    hypotheses = found.offered.hypotheses
    steps = [index for index in found.selection.accepted if hypotheses[index].family == FAMILY]
    return tuple(_anomaly(found, index, readings) for index in steps)


def _anomaly(found: Estimate, index: int, readings: Readings) -> Anomaly:
    one = found.offered.hypotheses[index]
    extended, members = found.extended, found.members[index]
    value, _ = extended.values_of(members[0])
    shift = extended.shift(members)
    concerned = np.any(shift != 0, axis=1)
    size = rms_length(shift[concerned])
    order, numbers = in_time(readings.configuration), readings.configuration
    k = number_of(one)
    inside = around(readings, order, k)
    first, last = int(order[inside].min()), int(order[inside].max())
    rows = inside & (order >= k if last + 1 - k <= k - first else order < k)
    span = (int(numbers[rows][0]), int(numbers[rows][-1]))
    vector = ", ".join(f"{1e3 * v:+z.2f}" for v in value[:3])
    constant = {
        "target_moved": f"in the frame of the flange ({vector} mm)",
        "tracker_moved": f"in the frame of the base ({vector} mm)",
        "zero_moved": f"in the angle of {one.location.get('joint')} ({vector} mrad): its zero was lost, or it slipped",
    }[one.effect]
    beside = _beside(found, index)
    alternative = f" A step of {' or '.join(beside)} fits nearly as well." if beside else ""
    before, after = int(numbers[order == k - 1][-1]), int(numbers[order == k][0])
    text = (
        f"between configurations {before} and {after} the readings step by "
        f"{1e3 * size:.2f} mm, constant {constant}; configurations {span[0]} to {span[1]} stand apart from the "
        f"others.{alternative}"
    )
    place = {key: value for key, value in one.location.items() if isinstance(value, str)}
    return Anomaly(one.effect, place, span, size, "m", text)


def _beside(found: Estimate, index: int) -> Sequence[str]:
    """Return other kinds of step at the same place in time that explain the data as well."""
    search, hypotheses = found.search, found.offered.hypotheses
    gain = search.scores(tuple(i for i in found.selection.accepted if i != index)).nats
    one, own = hypotheses[index], gain[search.place[index]]
    others: dict[str, None] = {}
    for i, k in search.place.items():
        other = hypotheses[i]
        if other.family != FAMILY or other.place == one.place or own - gain[k] > EQUIVALENT:
            continue
        if abs(number_of(other) - number_of(one)) <= NEAR:
            others[f"{other.effect} ({listed_location(other.location)})"] = None
    return tuple(others)
