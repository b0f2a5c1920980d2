"""A target or the tracker that moved part-way: which rows, in which frame, how far, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.estimation.estimate import Estimate
from calibration_core.estimation.shifts import FAMILY, around
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.identification.statistics.sizes import rms_length
from calibration_core.model.effects.candidate import number_of
from calibration_core.model.effects.words import listed_location
from calibration_core.timeseries import Readings, in_time

EQUIVALENT = 5.0  # nats
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
    frame = "the flange" if one.effect == "target_moved" else "the base"
    vector = ", ".join(f"{1e3 * v:+z.2f}" for v in value[:3])
    beside = _beside(found, index)
    alternative = f" A step of {' or '.join(beside)} fits nearly as well." if beside else ""
    before, after = int(numbers[order == k - 1][-1]), int(numbers[order == k][0])
    text = (
        f"between configurations {before} and {after} the readings step by "
        f"{1e3 * size:.2f} mm, constant in the frame of {frame} ({vector} mm); configurations {span[0]} to {span[1]} "
        f"stand apart from the others.{alternative}"
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
