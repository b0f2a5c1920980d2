"""From a compliance with its standard deviation to a stiffness with a 95 % interval, for every table alike.

The compliance is the quantity with a nearly normal error, and no joint has a negative one: what is known of it is the
normal distribution above zero.  The interval of the stiffness is the reciprocal of the interval of the compliance;
where the compliance is well determined this is the usual one, and where it may be zero it stays finite; a compliance
within two standard deviations of zero tells the least stiffness alone.
"""

from __future__ import annotations

import math

from scipy.special import ndtr, ndtri

from calibration_core.identification.result.estimate import JointStiffness
from calibration_core.identification.statistics.distributions import normal_quantile

DETERMINED = 2.0  # standard deviations that a compliance must exceed
FAR = 30.0  # standard deviations below zero beyond which the tail above zero is exponential
TWO_SIDED = normal_quantile(0.975)


def joint_stiffness(
    joint: str,
    compliance: float,
    std: float,
    *,
    centre: float | None = None,
    quantile: float = TWO_SIDED,
    identifiable: bool = True,
    reason: str = "",
    unit: str = "N*m/rad",
) -> JointStiffness:
    """Return the stiffness of one joint.

    Args:
        joint: Its name.
        compliance: rad/(N*m), not negative; where it is zero, the stiffness stated is the median of what is possible.
        std: Its standard deviation; infinite where the recording tells nothing.
        centre: rad/(N*m), the estimate without the bound at zero, on which the interval rests; None: `compliance`.
        quantile: Half width of the 95 % interval in standard deviations (Student's where `std` was estimated).
        identifiable: Whether the recording determines it; never where the compliance may be zero.
        reason: Why not, or what limits it.
        unit: Of the stiffness.
    """
    if not math.isfinite(std):
        value = 1 / compliance if compliance > 0 else math.inf
        return JointStiffness(joint, value, math.inf, (0.0, math.inf), compliance, std, identifiable, reason, unit)
    middle, wide = compliance if centre is None else centre, std * quantile / TWO_SIDED
    low, median, high = (positive_quantile(middle, wide, p) for p in (0.025, 0.5, 0.975))
    stated = compliance if compliance > 0 else median
    value = 1 / stated if stated > 0 else math.inf
    interval = (1 / high if high > 0 else math.inf, 1 / low if low > 0 else math.inf)
    spread = value * std / stated if compliance > 0 else (interval[1] - interval[0]) / (2 * TWO_SIDED)
    if not math.isfinite(value):  # declared rigid: no doubt, and no stiffness either
        spread = math.inf
    if std > 0 and compliance <= DETERMINED * std:
        identifiable = False
        reason = reason or f"its compliance may be zero: {at_least(interval[0], unit)}"
    return JointStiffness(joint, value, spread, interval, compliance, std, identifiable, reason, unit)


def at_least(stiffness: float, unit: str) -> str:
    """Return in words, in the unit of Table 2, that a stiffness (N*m/rad or N/m) is not below a value."""
    size = 1e-5 * stiffness
    places = max(1 - math.floor(math.log10(size)), 0) if 0 < size < math.inf else 0
    return f"the stiffness is at least {size:,.{places}f}·10⁵ {unit.replace('*', '·')}"


def positive_quantile(mean: float, std: float, probability: float) -> float:
    """Return the value that a normal variable, known to be positive, stays below with this probability."""
    if std <= 0:
        return max(mean, 0.0)
    if mean < -FAR * std:
        return -std * std / mean * -math.log1p(-probability)
    return float(mean - std * ndtri((1.0 - probability) * ndtr(mean / std)))
