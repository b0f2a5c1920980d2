"""How long an arc must be: what a circle's centre and axis will be worth, said before anything is measured (7.1)."""

from __future__ import annotations

import numpy as np

from calibration_core.timeseries import Float2D

FULL = 2 * np.pi
SHORTEST = np.radians(1.0)


def centre_std(arc: float, sigma: float, readings: int) -> float:
    """Return one standard deviation of a circle's centre in its worst direction, along the middle of the arc, m.

    The centre's two coordinates and the radius follow from radial distances alone, with derivatives cos t, sin t and 1
    (Cramér-Rao bound of a circle with free angles; it does not depend on the radius).

    Args:
        arc: Rad, at most a full turn.
        sigma: Standard deviation of one coordinate, m.
        readings: Evenly spaced on the arc, at least 4.

    Raises:
        ValueError: Fewer than four readings, or an arc that is none.
    """
    return float(sigma * np.sqrt(np.linalg.inv(_information(arc, readings))[0, 0]))


def arc_for(accuracy: float, sigma: float, readings: int) -> float | None:
    """Return the shortest arc, rad, whose centre has at most this standard deviation; None if a full turn is too short.

    Args:
        accuracy: Wanted standard deviation of the centre in its worst direction, m.
        sigma: Standard deviation of one coordinate, m.
        readings: Evenly spaced on the arc, at least 4.

    Raises:
        ValueError: Fewer than four readings.
    """
    low, high = SHORTEST, FULL
    if centre_std(high, sigma, readings) > accuracy:
        return None
    if centre_std(low, sigma, readings) <= accuracy:
        return low
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (low, middle) if centre_std(middle, sigma, readings) <= accuracy else (middle, high)
    return high


def _information(arc: float, readings: int) -> Float2D:
    """Return the (3, 3) information on centre (along the middle of the arc, across it) and radius, for unit noise."""
    if readings < 4 or not 0 < arc <= FULL:
        msg = f"{readings} readings on {np.degrees(arc):g} degrees, expected at least 4 on an arc of at most a turn"
        raise ValueError(msg)
    angle = np.linspace(-arc / 2, arc / 2, readings)
    design = np.column_stack([np.cos(angle), np.sin(angle), np.ones(readings)])
    return np.asarray(design.T @ design)
