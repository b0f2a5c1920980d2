"""Times as foreign programs write them: numbers, dates with times, and times of day alone."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from calibration_core.recording.foreign.units import UNITS, ForeignUnit
from calibration_core.timeseries import Float1D

FORMS = "seconds, a date and time (2019-05-28 18:01:10), or a time of day (10:15:30)"
DAY = 86400.0  # s
EPOCHS = (("ns", 1e17, 1e19), ("us", 1e14, 1e16), ("ms", 1e11, 1e13))  # since 1970: from 1973 to the year 2286
FIRST_DAY, LAST_DAY = 20_000.0, 75_000.0  # days since 1899-12-30, as spreadsheets count: 1954 to 2105
TO_1970 = 25_569.0  # d, from there
FROM_1904 = 2_082_844_800.0  # s from 1904, where LabVIEW begins to count, to 1970
LABVIEW = (3.0e9, 4.2e9)  # s from 1904: 1999 to 2037; from 1970 nobody has measured so late
FASTEST = 1e-3  # s: no tracker takes averaged readings as fast
_DATES = (
    "%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%d.%m.%Y", "%d.%m.%y", "%m/%d/%Y", "%m/%d/%y", "%d/%m/%Y", "%d/%m/%y",
    "%d-%m-%Y", "%m-%d-%Y", "%d-%b-%Y", "%d-%b-%y", "%d %b %Y", "%b %d %Y", "%d/%b/%Y",
)  # fmt: skip
_CLOCKS = ("%H:%M:%S.%f", "%H:%M", "%I:%M:%S.%f %p", "%I:%M %p")
_WHOLE = re.compile(r"(:\d{2}:\d{2})(?![.\d])")
_OF_DAY = re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:\.\d+)?)")
_COMMA = re.compile(r"(:\d{2}),(\d+)")
_FINER = re.compile(r"(\.\d{6})\d+")


def dated(texts: Sequence[str]) -> tuple[list[float | None], str]:
    """Return dates and times as seconds from 1970, UTC where no zone is stated, and how they were read.

    All are of one form.  Where day and month can be exchanged, the form is taken in which the times rise, else the
    month stands first.  What is none is None.
    """
    points = [_WHOLE.sub(r"\1.0", _COMMA.sub(r"\1.\2", text.strip())) for text in texts]
    plain = [" ".join(_FINER.sub(r"\1", text).replace(",", " ").split()) for text in points]
    best, how = [_iso(text) for text in plain], "dates and times"
    if None not in best:
        return best, how
    forms = [f"{date} {clock}" for date, clock in itertools.product(_DATES, _CLOCKS)]
    whole: dict[tuple[float | None, ...], str] = {}
    for form in forms:
        if plain and _read(plain[0], form) is not None:
            values = [_read(text, form) for text in plain]
            best = min(best, values, key=lambda one: one.count(None))
            if None not in values:
                whole.setdefault(tuple(values), form)
    ordered = sorted(whole, key=lambda one: bool((np.diff(np.array(one, dtype=float)) < 0).any()))
    if not ordered:
        return best, how
    if len(ordered) > 1:
        how += f", {whole[ordered[0]]}; {whole[ordered[1]]} fits as well"
    return list(ordered[0]), how


def _iso(text: str) -> float | None:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _read(text: str, form: str) -> float | None:
    try:
        return datetime.strptime(text, form).replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None


def counted(values: Float1D) -> tuple[ForeignUnit, str]:
    """Return the unit of times that are numbers without one, (m,), and why."""
    low, high = float(values.min(initial=np.inf)), float(values.max(initial=-np.inf))
    for name, least, most in EPOCHS:
        if least <= low and high <= most:
            return UNITS[name], "too large for seconds: counted from 1970"
    if LABVIEW[0] <= low and high <= LABVIEW[1]:
        return ForeignUnit("s", "time", 1.0, -FROM_1904), "too late for seconds from 1970: counted from 1904"
    steps = np.diff(np.unique(values))
    if low >= FIRST_DAY and high <= LAST_DAY and len(steps) and float(np.median(steps)) < FASTEST:
        days = ForeignUnit("d", "time", DAY, -TO_1970)
        return days, "too close together for seconds: days as spreadsheets count them"
    return UNITS["s"], "the usual unit"


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
