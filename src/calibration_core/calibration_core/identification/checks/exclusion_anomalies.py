"""What is wrong with the data and no physics of the robot, as far as an identification notices it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calibration_core.identification.result.estimate import Anomaly, Exclusion, NoiseAudit
from calibration_core.input_checks.loaded import MANY, OVERSTATED, overstated_words
from calibration_core.timeseries import Readings

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
