"""How much a recording holds, in words: configurations, and how many of them are postures at rest beside loads."""

from __future__ import annotations

from calibration_core.observations.kinds import postures_at_rest
from calibration_core.report.rounding import counted
from calibration_core.timeseries import Readings


def configurations_text(readings: Readings, count: int) -> str:
    """Return a number of configurations of some readings, those at rest beside loaded ones named."""
    rest = postures_at_rest(readings)
    beside = f" ({rest:,} of them {'a posture' if rest == 1 else 'postures'} at rest)" if rest else ""
    return f"{counted(count, 'configuration')}{beside}"
