"""One quantity of one robot over its dates: what it is now, how fast it changes, where it jumped, how long it lasts.

Values are straight lines over time within segments between changes; a segment ends where a step explains the dates
significantly better, found by binary segmentation.  Whether one step or one slope is the cause is said only where one
of them explains the dates better by 3 nats.

Sources: weighted least squares; binary segmentation (Scott and Knott, 1974, doi:10.2307/2529204); intervals of a
crossing after Fieller (1954, Journal of the Royal Statistical Society B 16).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Literal

import numpy as np

from calibration_core.acceptance.yearly_change import weighted_line, weighted_mean
from calibration_core.timeseries import Float1D

COVERAGE = 1.959964
AS_GOOD = 6.0  # chi-squared (3 nats): a cause that explains nearly as much
MONTHS = 12.0  # per year
HORIZON = 600.0  # months: what lies beyond is never
Cause = Literal["none", "change", "trend", "change_or_trend"]


@dataclasses.dataclass(frozen=True)
class Change:
    """A step between two dates.

    Attributes:
        index: Of the first date after it.
        size: By how much, in the unit of the values.
        std: Standard deviation of `size`.
    """

    index: int
    size: float
    std: float


@dataclasses.dataclass(frozen=True)
class Life:
    """Months from the last date until a limit is reached.

    Attributes:
        months: The likeliest; infinite where the value moves away from the limit.
        low, high: Ends of the 95 % interval; `high` infinite where the trend may be none.
        known: Whether something may be said: the trend towards the limit is significant.
    """

    months: float
    low: float
    high: float
    known: bool


@dataclasses.dataclass(frozen=True, eq=False)
class History:
    """A quantity of a robot over its dates.

    Attributes:
        value: What it is now, as far as all dates since the last change tell.
        std: Standard deviation of `value`.
        slope: Per year, a line through all dates since the last change; NaN from one date.  Of the logarithm of a
            stiffness: `acceptance.yearly_change` turns it into a relative change.
        slope_std: Its standard deviation.
        changes: Steps, in the order of time.
        cause: What changed it, if anything.
        dates: Number of dates.
    """

    value: float
    std: float
    slope: float
    slope_std: float
    changes: tuple[Change, ...]
    cause: Cause
    dates: int

    @property
    def slope_interval(self) -> tuple[float, float]:
        """95 % interval of the slope, per year; infinite from one date."""
        if not math.isfinite(self.slope):
            return -math.inf, math.inf
        return self.slope - COVERAGE * self.slope_std, self.slope + COVERAGE * self.slope_std


def history(years: Float1D, value: Float1D, std: Float1D, critical: float) -> History:
    """Return what the dates say.

    Args:
        years: (d,) dates in the order of time, years.
        value: (d,) measured.
        std: (d,) standard deviations, positive.
        critical: Standard deviations that a step or slope must have to be stated.
    """
    changes = _segmented(value, std, critical)
    start = changes[-1].index if changes else 0
    line = weighted_line(years[start:], value[start:], std[start:])
    cause: Cause = "change" if changes else "none"
    steep = math.isfinite(line.slope) and line.slope_std > 0 and abs(line.slope) > critical * line.slope_std
    if changes and len(value) >= 3:
        cause = _cause(years, value, std, changes, critical)
        if cause == "trend":
            changes, start = (), 0
            line = weighted_line(years, value, std)
            steep = True
    elif steep:
        cause = "trend"
    if steep and cause == "trend":
        now, now_std = _at_end(years[start:], value[start:], std[start:])
    else:
        now, now_std = line.mean, line.mean_std
    return History(now, now_std, line.slope, line.slope_std, changes, cause, len(value))


def life(found: History, limit: float) -> Life:
    """Return how long it takes until the value reaches a limit, on the line through the dates since the last change.

    Args:
        found: The history; its trend decides.
        limit: In the unit of the values.
    """
    distance = limit - found.value
    towards = math.copysign(1.0, distance) * found.slope if math.isfinite(found.slope) else math.nan
    if not math.isfinite(towards):
        return Life(math.inf, 0.0, math.inf, known=False)
    low, high = sorted(math.copysign(1.0, distance) * end for end in found.slope_interval)
    gap = abs(distance)
    months = MONTHS * gap / towards if towards > 0 else math.inf
    early = MONTHS * max(gap - COVERAGE * found.std, 0.0) / high if high > 0 else math.inf
    late = MONTHS * (gap + COVERAGE * found.std) / low if low > 0 else math.inf
    known = found.cause == "trend" and low > 0
    months, early, late = (math.inf if x > HORIZON else x for x in (months, early, late))
    return Life(months, early, late, known)


def _segmented(value: Float1D, std: Float1D, critical: float) -> tuple[Change, ...]:
    """Return the steps whose size exceeds `critical` standard deviations, the clearest first to be split at."""
    ends = [0, len(value)]
    while True:
        best, where = critical, 0
        for start, end in itertools.pairwise(ends):
            for k in range(start + 1, end):
                step, error = _step(value, std, start, k, end)
                if abs(step) > best * error:
                    best, where = abs(step) / error, k
        if where == 0:
            break
        ends = sorted([*ends, where])
    found = []
    for start, k, end in zip(ends, ends[1:], ends[2:], strict=False):
        step, error = _step(value, std, start, k, end)
        found.append(Change(k, step, error))
    return tuple(found)


def _step(value: Float1D, std: Float1D, start: int, k: int, end: int) -> tuple[float, float]:
    (before, before_std), (after, after_std) = (
        weighted_mean(value[part], std[part]) for part in (slice(start, k), slice(k, end))
    )
    return after - before, math.hypot(before_std, after_std)


def _at_end(years: Float1D, value: Float1D, std: Float1D) -> tuple[float, float]:
    line = weighted_line(years, value, std)
    weight = 1 / std**2
    lever = float(years[-1] - np.sum(weight * years) / np.sum(weight))
    return line.mean + line.slope * lever, math.hypot(line.mean_std, line.slope_std * lever)


def _cause(years: Float1D, value: Float1D, std: Float1D, changes: tuple[Change, ...], critical: float) -> Cause:
    """Say whether steps or one line through all dates explain more, each number costing what makes it significant."""
    fitted = weighted_line(years, value, std)
    weight = 1 / std**2
    centred = years - float(np.sum(weight * years) / np.sum(weight))
    line = float(np.sum(((value - fitted.mean - fitted.slope * centred) / std) ** 2)) + critical**2
    ends = [0, *(change.index for change in changes), len(value)]
    steps = critical**2 * len(changes)
    for start, end in itertools.pairwise(ends):
        level, _ = weighted_mean(value[start:end], std[start:end])
        steps += float(np.sum(((value[start:end] - level) / std[start:end]) ** 2))
    if abs(line - steps) < AS_GOOD:
        return "change_or_trend"
    return "trend" if line < steps else "change"
