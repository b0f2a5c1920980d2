"""How fast a quantity changes over time: one definition for `compare` and `fleet`.

A stiffness is followed as its logarithm: a straight line through ln K over the dates is a constant relative change per
year, exp(slope) - 1, so that n years at that rate change K by (1 + yearly change)^n - 1.  A stiffness that has fallen
by 10.6 % in two years has fallen by 5.4 % a year.  Every other quantity (backlash, hysteresis, an effect's parameter)
is followed as it is; its yearly change is the slope, in its unit per year.

Source: weighted least squares of value on date; compound growth.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.timeseries import Float1D

FASTEST = 700.0  # per year: the exponential of more is beyond what floating point holds


@dataclasses.dataclass(frozen=True, eq=False)
class WeightedLine:
    """A straight line through values over time.

    Attributes:
        mean: Weighted mean of the values.
        mean_std: Its standard deviation.
        slope: Per year; NaN where all dates are the same.
        slope_std: Its standard deviation; infinite where all dates are the same.
    """

    mean: float
    mean_std: float
    slope: float
    slope_std: float


def weighted_mean(value: Float1D, std: Float1D) -> tuple[float, float]:
    """Return the weighted mean and its standard deviation."""
    weight = 1 / std**2
    return float(np.sum(weight * value) / np.sum(weight)), 1 / math.sqrt(float(np.sum(weight)))


def weighted_line(years: Float1D, value: Float1D, std: Float1D) -> WeightedLine:
    """Return the line through values.

    Args:
        years: (d,) dates, years.
        value: (d,) measured; the logarithm of a stiffness.
        std: (d,) standard deviations, positive.
    """
    mean, mean_std = weighted_mean(value, std)
    if np.ptp(years) <= 0:
        return WeightedLine(mean, mean_std, math.nan, math.inf)
    weight = 1 / std**2
    centred = years - float(np.sum(weight * years) / np.sum(weight))
    information = float(np.sum(weight * centred**2))
    slope = float(np.sum(weight * centred * value)) / information
    return WeightedLine(mean, mean_std, slope, 1 / math.sqrt(information))


def yearly_change(slope: float) -> float:
    """Return the relative change of a stiffness in one year from the slope of its logarithm, per year.

    It takes the ends of an interval as well, and steps of the logarithm, whose relative size it returns.
    """
    return math.expm1(slope) if slope < FASTEST else math.inf
