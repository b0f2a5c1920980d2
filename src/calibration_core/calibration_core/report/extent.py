"""How much a recording holds, in words: configurations, and how many of them are without load beside others."""

from __future__ import annotations

from calibration_core.observations.kinds import postures_at_rest, unloaded_visits
from calibration_core.report.rounding import counted
from calibration_core.timeseries import Readings


def configurations_text(readings: Readings, count: int) -> str:
    """Return a number of configurations of some readings, those without load beside loaded ones named."""
    rest, visits = postures_at_rest(readings), len(unloaded_visits(readings))
    beside = [f"{rest:,} of them {'a posture' if rest == 1 else 'postures'} at rest"] if rest else []
    beside += [f"{visits:,} of them visited without load"] if visits else []
    return counted(count, "configuration") + (f" ({', '.join(beside)})" if beside else "")


def without_load_note(readings: Readings) -> str:
    """Return which configurations were visited without load alone, beside loaded ones; empty where none were."""
    visits = unloaded_visits(readings)
    if not visits:
        return ""
    one = len(visits) == 1
    numbers = ", ".join(str(number) for number in visits)
    return f"Configuration{'' if one else 's'} {numbers} {'was' if one else 'were'} visited without load."
