"""Times as foreign programs write them: numbers, dates with times, and times of day alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from calibration_core.timeseries import Float1D

FORMS = "seconds, a date and time, or a time of day (10:15:30)"
DAY = 86400.0  # s
_DATED = tuple(
    one
    for form in ("%d.%m.%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%m/%d/%Y %I:%M:%S %p")
    for one in (form, form.replace("%S", "%S.%f"))
)
_OF_DAY = re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:\.\d+)?)")
_COMMA = re.compile(r"(:\d{2}),(\d+)")


def dated(text: str) -> float | None:
    """Return a date and time as seconds from 1970, UTC where no zone is stated; None where the text is none."""
    text = _COMMA.sub(r"\1.\2", text.strip())
    try:
        moment = datetime.fromisoformat(text)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    except ValueError:
        pass  # not ISO 8601: the other forms are tried
    for form in _DATED:
        try:
            return datetime.strptime(text, form).replace(tzinfo=UTC).timestamp()
        except ValueError:
            continue
    return None


def of_day(text: str) -> float | None:
    """Return a time of day as seconds from midnight; None where the text is none."""
    match = _OF_DAY.fullmatch(_COMMA.sub(r"\1.\2", text.strip()))
    if match is None or int(match[1]) > 23:
        return None
    return 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3])


def over_midnight(times: Sequence[float]) -> Float1D:
    """Return times of day in order of measurement, (m,): where they fall by more than half a day, a day begins."""
    values = np.asarray(times, dtype=float)
    begins = np.r_[0.0, np.cumsum(np.diff(values) < -DAY / 2)] if len(values) else values
    return np.asarray(values + DAY * begins)
