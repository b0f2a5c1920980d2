"""The parts of a result.json, for those who describe it: passed over where they are missing, or are no number.

A result may have been edited or be of an earlier version.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from calibration_core.report.rounding import fixed

Content = Mapping[str, Any]
FEW = 5  # rows that are named
HUGE = 1e300  # a larger number is no size of anything, and may be beyond what floating point holds


def records(of: Content, key: str) -> list[Content]:
    """Return the records of a list in a result; none where there is no such list."""
    value = of.get(key)
    return [one for one in value if isinstance(one, Mapping)] if isinstance(value, list) else []


def part(of: Content, key: str) -> Content:
    """Return a mapping in a result; an empty one where there is none."""
    value = of.get(key)
    return value if isinstance(value, Mapping) else {}


def number(of: Content, key: str) -> float:
    """Return a number of a result; NaN where there is none."""
    return finite(of.get(key))


def numbers(of: Content, key: str) -> list[float]:
    """Return the numbers of a list in a result, NaN for what is none; none where there is no list."""
    value = of.get(key)
    return [finite(one) for one in value] if isinstance(value, list) else []


def finite(value: Any) -> float:
    """Return what is a number of a plausible size, else NaN."""
    return float(value) if isinstance(value, int | float) and abs(value) < HUGE else math.nan


def known(*values: float) -> bool:
    """Say whether all numbers are there."""
    return all(math.isfinite(value) for value in values)


def texts(of: Content, key: str) -> list[str]:
    """Return the entries of a list in a result as texts; none where there is no list."""
    value = of.get(key)
    return [str(one) for one in value] if isinstance(value, list) else []


def mm(value: float) -> str:
    """Return a length in m as mm."""
    return f"{fixed(1e3 * value, 3)} mm"


def percent(value: float) -> str:
    """Return a relative change in % with its sign."""
    return f"{'+' if value > 0 else ''}{fixed(100 * value, 2)} %"
