"""What a recording can tell about each joint, and what it cannot."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr, ndtri

from calibration_core.identification.result.estimate import DECLARED_RIGID, JointStiffness, Unidentified
from calibration_core.identification.statistics import Solution, normal_quantile, student_quantile
from calibration_core.timeseries import Float1D

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


HARDLY = 1 / 3  # relative standard deviation above which a compliance is within three sigma of zero: a rigid joint
WEAK_DIRECTION = 1e-4  # eigenvalue of the column-scaled normal matrix: columns parallel to 1 %
NAMED = 0.2  # parameters below this share of a weak direction are not named


def stiffness_table(
    joints: tuple[str, ...],
    solution: Solution,
    scale: float,
    freedom: int | None,
    torque_rms: Float1D,
    prismatic: tuple[bool, ...] = (),
    rigid: tuple[bool, ...] = (),
) -> tuple[JointStiffness, ...]:
    """Turn compliances into stiffnesses with 95 % intervals, see `joint_stiffness`.

    Args:
        joints: Names.
        solution: Compliances and their covariance for unit weight.
        scale: Factor on the standard deviations.
        freedom: Degrees of freedom of `scale` if it was estimated; None if the claimed noise is used.
        torque_rms: (n,) N*m, how much load torque (N where it slides) each joint saw.
        prismatic: Per joint, whether it slides; none where empty.
        rigid: Per joint, whether it is declared rigid; none where empty.
    """
    quantile = TWO_SIDED if freedom is None else student_quantile(0.975, max(freedom, 1))
    table = []
    for i, joint in enumerate(joints):
        value = float(solution.value[i])
        std = scale * float(np.sqrt(solution.covariance[i, i]))
        relative = std / value if value > 0 else np.inf
        stated_rigid = bool(rigid) and rigid[i]
        slides = bool(prismatic) and prismatic[i]
        table.append(
            joint_stiffness(
                joint,
                value,
                std,
                centre=float(solution.unbounded[i]) if solution.determined[i] else value,
                quantile=quantile,
                identifiable=bool(solution.determined[i]) and relative <= HARDLY,
                reason=DECLARED_RIGID
                if stated_rigid
                else _reason(solution, i, relative, _load(float(torque_rms[i]), slides=slides)),
                unit="N/m" if slides else "N*m/rad",
            )
        )
    return tuple(table)


def _load(size: float, *, slides: bool) -> str:
    return f"load {float(f'{size:.3g}'):,g} {'N' if slides else 'N·m'}"


def _reason(solution: Solution, i: int, relative: float, load: str) -> str:
    if not solution.determined[i]:
        return f"not identifiable: no load on this joint that another joint does not share ({load} rms)"
    if solution.at_bound[i]:
        return f"not distinguishable from a rigid joint: the best compliance is zero ({load} rms)"
    if relative > HARDLY:
        return f"hardly identifiable: the standard deviation of its compliance exceeds a third of it ({load} rms)"
    return ""


def weak_directions(
    names: tuple[str, ...], solution: Solution, rigid: tuple[bool, ...] = ()
) -> tuple[Unidentified, ...]:
    """Name the combinations of parameters that the recording cannot, or hardly, determine.

    Args:
        names: (n,) names of the parameters.
        solution: With the eigenvectors of the column-scaled normal matrix.
        rigid: Per parameter, whether it is of a joint that is declared rigid and not asked for; none where empty.
    """
    found = []
    for i, name in enumerate(names):
        if rigid and rigid[i]:
            continue
        if not solution.determined[i] and np.abs(solution.eigenvectors[i]).max() > 1 - NAMED**2:
            found.append(Unidentified({name: 1.0}, f"the readings do not depend on {name}"))
    largest = float(solution.eigenvalues[-1])
    for value, vector in zip(solution.eigenvalues, solution.eigenvectors.T, strict=True):
        if value > WEAK_DIRECTION * largest:
            continue
        weights = vector / vector[np.argmax(np.abs(vector))]
        combination = {name: float(w) for name, w in zip(names, weights, strict=True) if abs(w) >= NAMED}
        if len(combination) > 1:
            gain = np.sqrt(largest / value) if value > 0 else np.inf
            found.append(
                Unidentified(combination, f"only their sum shows: errors in this combination grow {gain:.3g} times")
            )
    return tuple(found)
