"""Measurements of one robot at different times, or of twins: what has changed, what has not, and what stays open.

Compliances of two measurements differ by d, normal about the change with the sum of both covariances.  A robot that
ages changes in few places: the change is looked for joint by joint, each with the others as found before (forward
selection on conditional statistics); the level holds for all joints of all pairs together (Bonferroni).
Sources: generalised least squares; Miller, Subset selection in regression, 2nd ed. (2002).
"""

from __future__ import annotations

import dataclasses
import datetime as dt
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from calibration_core.acceptance.yearly_change import weighted_line, yearly_change
from calibration_core.identification.statistics import normal_quantile
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.timeseries import Float1D, Float2D

STIFFNESS_LEVEL = 0.006  # probability that anything is said to have changed where nothing has: stiffnesses
LAW_LEVEL = 0.002  # the same of backlash, hysteresis and effects
POWER = 0.9  # with which a change of the limit's size is found by the number of configurations that is stated
LIMIT = 0.05  # of a stiffness: what is smaller is no change
COVERAGE = 1.96  # 95 %
AS_GOOD = 6.0  # chi-squared (3 nats): a change elsewhere that explains nearly as much
YEAR = 365.25 * 86400.0  # s
COMPLIANCE = "compliance."
OF_JOINTS = ("stiffness", "compliance")  # the two quantities that say how much a joint gives way
Verdict = Literal["changed", "not_changed", "cannot_tell"]


@dataclasses.dataclass(frozen=True, eq=False)
class Measurement:
    """One of the measurements.

    Attributes:
        date: When, UTC; None where it is not known.
        configurations: Number of measured configurations.
        compliance: Compliances of the joints, named `compliance.JOINT`.
        laws: Other quantities, each for itself, e.g. `backlash.joint_2`; one without a name here was not measured.
    """

    label: str
    date: dt.datetime | None
    configurations: int
    compliance: GaussianEstimate
    laws: GaussianEstimate


@dataclasses.dataclass(frozen=True)
class QuantityChange:
    """One quantity of one measurement beside the first.

    Attributes:
        quantity: `stiffness`, or `compliance` of a joint that one of the two measurements shows as rigid; `backlash`,
            `hysteresis`, or an effect's parameter.
        location: Joint, or where the effect is.
        first: Value of the first measurement, SI.
        unit: Of both.
        change: Relative change of a stiffness, absolute one of all others (in `unit`).
        low: Lower end of its 95 % interval.
        high: Upper end.
        verdict: What may be said.
        configurations: With how many configurations in each of the two a change of `limit` would be told; None where
            these are enough, or nothing is known of the quantity.
        limit: What is smaller is no change, as `change`.
        or_else: Joints whose change explains the measurements nearly as well.
    """

    quantity: str
    location: str
    first: float
    second: float
    unit: str
    change: float
    low: float
    high: float
    verdict: Verdict
    configurations: int | None
    limit: float
    or_else: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Trend:
    """How fast a quantity changes, from all measurements of it: a straight line over time, through ln K of a stiffness.

    Attributes:
        quantity: As in `QuantityChange`.
        location: As there.
        slope: Relative change of a stiffness in one year, exp(slope of ln K) - 1; per year in `unit` for all others.
        low: Lower end of its 95 % interval.
        high: Upper end.
        unit: `1/year`, or the quantity's unit per year.
        verdict: `changed` where the slope is not zero at the level of all tests together.
    """

    quantity: str
    location: str
    slope: float
    low: float
    high: float
    unit: str
    verdict: Verdict


def compare(
    measurements: Sequence[Measurement], law_limit: float, limit: float = LIMIT
) -> tuple[tuple[QuantityChange, ...], ...]:
    """Compare every later measurement with the first.

    Args:
        measurements: Two or more.
        law_limit: Size of a backlash or hysteresis below which a change is none, rad.
        limit: The same of a stiffness, relative.

    Returns:
        Per measurement after the first its differences.
    """
    first, *others = measurements
    pairs = len(others)
    return tuple(
        (*_stiffnesses(first, other, limit, pairs), *_laws(first, other, law_limit, pairs)) for other in others
    )


def trends(measurements: Sequence[Measurement]) -> tuple[Trend, ...]:
    """Return the trends of what all measurements have in common; none for fewer than three, or without their dates.

    The definition is that of `yearly_change`.
    """
    dates = [one.date for one in measurements if one.date is not None]
    if len(dates) < 3 or len(dates) < len(measurements) or len(set(dates)) < 3:
        return ()
    time = np.array([date.timestamp() for date in dates]) / YEAR
    found = []
    for group, level in (("compliance", STIFFNESS_LEVEL), ("laws", LAW_LEVEL)):
        estimates: list[GaussianEstimate] = [getattr(one, group) for one in measurements]
        names = [name for name in estimates[0].names if all(_known(one, name) for one in estimates)]
        for name in names:
            index = [one.names.index(name) for one in estimates]
            value = np.array([one.value[k] for one, k in zip(estimates, index, strict=True)])
            std = np.array([one.std[k] for one, k in zip(estimates, index, strict=True)])
            unit = estimates[0].units[index[0]]
            found.append(_trend(name, unit, time, value, std, critical_size(level, len(names))))
    return tuple(one for one in found if one is not None)


def _trend(name: str, unit: str, time: Float1D, value: Float1D, std: Float1D, critical: float) -> Trend | None:
    quantity, location = _named(name)
    relative = quantity == "stiffness"
    if relative:
        if not (value > 0).all():  # the logarithm of no spring
            return None
        value, std = -np.log(value), std / value  # ln K = -ln C
    line = weighted_line(time, value, std)
    verdict: Verdict = "changed" if abs(line.slope) > critical * line.slope_std else "cannot_tell"
    half = COVERAGE * line.slope_std
    slope, low, high = line.slope, line.slope - half, line.slope + half
    if relative:
        slope, low, high = (yearly_change(x) for x in (slope, low, high))
    return Trend(quantity, location, slope, low, high, "1/year" if relative else f"{unit}/year", verdict)


def _stiffnesses(first: Measurement, other: Measurement, limit: float, pairs: int) -> list[QuantityChange]:
    one, two = first.compliance, other.compliance
    names = [name for name in one.names if name in two.names]
    known = [name for name in names if _known(one, name) and _known(two, name)]
    a, b = (estimate.chosen([estimate.names.index(name) for name in known]) for estimate in (one, two))
    difference, covariance = b.value - a.value, a.covariance + b.covariance
    critical = critical_size(STIFFNESS_LEVEL / pairs, len(known))
    changed = changes(difference, covariance, critical)
    found = []
    for name in names:
        unit = one.units[one.names.index(name)]
        before, after = (float(estimate.value[estimate.names.index(name)]) for estimate in (one, two))
        if name not in known:
            found.append(_joint(name, unit, (before, after), (-math.inf, math.inf), "cannot_tell", None, limit))
            continue
        k = known.index(name)
        std, d = math.sqrt(covariance[k, k]), float(difference[k])
        ends, typical = _ends((before, after), (d - COVERAGE * std, d + COVERAGE * std)), before
        own = limit
        if min(before, after) <= 0:
            own, typical = limit * max(before, after, 0.0), 1.0
        verdict = _verdict(k in changed, max(map(abs, ends)), own)
        needed = _needed(verdict, (first.configurations, other.configurations), std / typical, own, critical)
        alike = tuple(known[j].removeprefix(COMPLIANCE) for j in changed.get(k, ()))
        found.append(_joint(name, unit, (before, after), ends, verdict, needed, own, alike))
    return found


def _ends(values: tuple[float, float], difference: tuple[float, float]) -> tuple[float, float]:
    """Return the ends of an interval of a joint's change, as `_joint` states it, from those of its compliance."""
    before, after = values
    if min(before, after) <= 0:
        return difference
    low, high = (-d / (before + d) if before + d > 0 else math.inf for d in reversed(difference))
    return low, high


def _joint(
    name: str,
    unit: str,
    values: tuple[float, float],
    ends: tuple[float, float],
    verdict: Verdict,
    needed: int | None,
    limit: float,
    alike: tuple[str, ...] = (),
) -> QuantityChange:
    """Return the relative change of a joint's stiffness; of its compliance where one of the two is none.

    Args:
        name: Of the compliance.
        unit: Of the compliance.
        values: Both compliances.
        ends: Of the interval, as `_ends` gives them.
        verdict: As in `QuantityChange`, as all below.
        needed: `configurations`.
        limit: For `stiffness` relative, for `compliance` in its unit.
        alike: `or_else`.
    """
    location, (before, after) = name.removeprefix(COMPLIANCE), values
    if min(values) <= 0:  # a stiffness beyond all bounds has no relative change, and JSON no number for it
        change = after - before
        return QuantityChange("compliance", location, before, after, unit, change, *ends, verdict, needed, limit, alike)
    stiffness, change = "N/m" if unit == "m/N" else "N*m/rad", before / after - 1
    return QuantityChange(
        "stiffness", location, 1 / before, 1 / after, stiffness, change, *ends, verdict, needed, limit, alike
    )


def changes(difference: Float1D, covariance: Float2D, critical: float) -> dict[int, tuple[int, ...]]:
    """Return which of p numbers have changed -> which others explain that change nearly as well.

    Args:
        difference: (p,).
        covariance: (p, p) of it.
        critical: What the largest of p standard normal variables exceeds rarely enough.
    """
    p = len(difference)
    if p == 0:
        return {}
    scale = np.sqrt(np.diag(covariance))  # compliances differ by factors of a hundred
    precision = np.linalg.inv(covariance / np.outer(scale, scale))
    scaled = difference / scale
    found: dict[int, tuple[int, ...]] = {}
    while len(found) < p:
        chosen = list(found)
        left = precision
        if chosen:
            columns = precision[:, chosen]
            left = precision - columns @ np.linalg.solve(precision[np.ix_(chosen, chosen)], columns.T)
        open_ = [k for k in range(p) if k not in found]
        size = np.full(p, -1.0)
        size[open_] = np.abs(left @ scaled)[open_] / np.sqrt(np.maximum(np.diag(left)[open_], 1e-300))
        best = int(np.argmax(size))
        if size[best] <= critical:
            break
        near = tuple(k for k in open_ if k != best and size[best] ** 2 - size[k] ** 2 < AS_GOOD)
        found[best] = near
    return found


def _laws(first: Measurement, other: Measurement, limit: float, pairs: int) -> list[QuantityChange]:
    one, two = first.laws, other.laws
    names = [name for name in one.names if _known(one, name) and _known(two, name)]
    critical = critical_size(LAW_LEVEL / pairs, len(names))
    found = []
    for name in names:
        j, k = one.names.index(name), two.names.index(name)
        change, std = float(two.value[k] - one.value[j]), math.hypot(one.std[j], two.std[k])
        low, high = change - COVERAGE * std, change + COVERAGE * std
        own = limit if one.units[j] == "rad" else LIMIT * max(abs(one.value[j]), abs(two.value[k]))
        verdict = _verdict(abs(change) > critical * std, max(abs(low), abs(high)), own)
        needed = _needed(verdict, (first.configurations, other.configurations), std, own, critical)
        quantity, location = _named(name)
        values = float(one.value[j]), float(two.value[k])
        found.append(QuantityChange(quantity, location, *values, one.units[j], change, low, high, verdict, needed, own))
    return found


def _verdict(changed: bool, farthest: float, limit: float) -> Verdict:
    if changed:
        return "changed"
    return "not_changed" if farthest <= limit else "cannot_tell"


def _needed(verdict: Verdict, configurations: tuple[int, int], std: float, limit: float, critical: float) -> int | None:
    """Return how many configurations in each would tell a change of the limit, the variance falling as their number."""
    if verdict != "cannot_tell" or limit <= 0:
        return None
    number = 2 / sum(1 / count for count in configurations)  # the harmonic mean: variances add
    return math.ceil(number * (std * (critical + normal_quantile(POWER)) / limit) ** 2)


def critical_size(level: float, tests: int) -> float:
    """Return what the largest of so many standard normal sizes exceeds with this probability at most (Bonferroni)."""
    return normal_quantile(1 - level / (2 * max(tests, 1)))


def _known(estimate: GaussianEstimate, name: str) -> bool:
    if name not in estimate.names:
        return False
    k = estimate.names.index(name)
    return bool(np.isfinite(estimate.std[k]) and estimate.std[k] > 0)


def _named(name: str) -> tuple[str, str]:
    quantity, _, location = name.partition(".")
    return ("stiffness", location) if quantity == "compliance" else (quantity, location)
