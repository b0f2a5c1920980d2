"""What an arc is worth, in words: said before the measurement and after it (CWA 17384, 7.1)."""

from __future__ import annotations

import numpy as np

from calibration_core.identification.circle_point.circle import FULL, arc_for, centre_std
from calibration_core.report.rounding import significant

WANTED = 1e-4  # m, accuracy of a circle's centre for which the arc is stated


def describe_arc(arc: float, sigma: float, readings: int, noun: str) -> str:
    """Return how long an arc is, how well it fixes a circle's centre, and which arc would be enough.

    Args:
        arc: Rad; more than a full turn counts as one.
        sigma: Standard deviation of one coordinate of a point, m.
        readings: Evenly spaced on the arc, at least 4.
        noun: What a reading is called.
    """
    worth, enough = centre_std(min(arc, FULL), sigma, readings), arc_for(WANTED, sigma, readings)
    text = (
        f"{np.degrees(arc):.0f} degrees in {readings} {noun} fix a circle's centre to {significant(1e6 * worth)} µm "
        "along the middle of the arc"
    )
    if enough is not None:
        text += f" (for {1e6 * WANTED:.0f} µm {np.degrees(enough):.0f} degrees are enough)"
    return text
