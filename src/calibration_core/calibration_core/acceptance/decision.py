"""The decision rule of ISO 14253-1 for a size that may not exceed a tolerance.

A measured size conforms where it keeps away from the tolerance by a guard band, does not conform where it exceeds the
tolerance by one, and is undecided between: the uncertainty of measurement goes against whoever has to prove.  The guard
band is the one-sided quantile of the conformance probability times the standard uncertainty (ISO 14253-1:2017,
default 95 %: 1.645 u).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from calibration_core.identification.statistics import normal_quantile
from calibration_core.timeseries import Float1D

Decision = Literal["conforming", "not_conforming", "undecided"]
PROBABILITY = 0.95
COVERAGE = 2.0  # factor of the expanded uncertainties that a certificate states, for about 95 %
WORDS: dict[Decision, str] = {
    "conforming": "conforming",
    "not_conforming": "not conforming",
    "undecided": "undecided because of measurement uncertainty",
}


def guard_factor(probability: float = PROBABILITY) -> float:
    """Return the guard band in standard uncertainties for a conformance probability."""
    return normal_quantile(probability)


def decide(size: Float1D, uncertainty: Float1D, tolerance: float, probability: float = PROBABILITY) -> list[Decision]:
    """Decide for every size.

    Args:
        size: (m,) measured sizes.
        uncertainty: (m,) their standard uncertainties, same unit.
        tolerance: What they may not exceed, same unit.
        probability: Of conformance.
    """
    band = guard_factor(probability) * np.asarray(uncertainty)
    return [
        "conforming" if one + guard <= tolerance else "not_conforming" if one - guard > tolerance else "undecided"
        for one, guard in zip(size, band, strict=True)
    ]


def overall(decisions: Sequence[Decision]) -> Decision:
    """Return the decision on a whole: not conforming if a part is not, conforming if all are."""
    if "not_conforming" in decisions:
        return "not_conforming"
    return "undecided" if "undecided" in decisions else "conforming"
