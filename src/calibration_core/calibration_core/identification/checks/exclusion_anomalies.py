"""What is wrong with the data and no physics of the robot, as far as an identification notices it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calibration_core.identification.result.estimate import Anomaly, Exclusion, NoiseAudit
from calibration_core.timeseries import Readings


def exclusion(readings: Readings, row: int, reason: str, size: float, squared: float) -> Exclusion:
    """Name a reading that is not used: its row, why, the length of its residual, m, and its square in variances."""
    place = int(readings.configuration[row]), int(readings.step[row]), readings.points[readings.point[row]]
    return Exclusion(*place, reason=reason, size=float(size), times_sigma=math.sqrt(squared))


def anomalies_of(noise: NoiseAudit, exclusions: Sequence[Exclusion], readings: Readings) -> tuple[Anomaly, ...]:
    """Return understated noise, excluded readings and unsettled plateaus.

    Args:
        noise: Claimed against seen.
        exclusions: Readings not used.
        readings: With the notes of what was set aside before.
    """
    found = []
    if noise.understated:
        seen = noise.claimed * noise.scale
        found.append(Anomaly("noise_understated", {"instrument": "tracker"}, None, seen, "m", noise.text))
    if exclusions:
        largest = max(exclusions, key=lambda exclusion: exclusion.size)
        numbers = [exclusion.configuration for exclusion in exclusions]
        where: dict[str, str | int] = {
            "point": largest.point,
            "configuration": largest.configuration,
            "step": largest.step,
        }
        text = f"{len(exclusions)} readings excluded, each named"
        found.append(Anomaly("outlier_readings", where, (min(numbers), max(numbers)), largest.size, "m", text))
    unsettled = [note for note in readings.notes if note.kind == "unsettled"]
    found += [Anomaly("unsettled", {"place": n.place}, None, float(n.count), "1", n.text) for n in unsettled]
    return tuple(found)
