"""Table 2 with the bias of what the standard's model leaves out.

A joint stiffness of the standard's model takes up part of whatever physics is missing beside the joints.  The extended
model says by how much: the compliance c of the standard is off by b = c - c_e, with the uncertainty u of c_e.  The
standard's value stays as it is, and its 95 % interval becomes c +- h, which the truth, normal about c_e, is in with
95 % probability: h is that quantile of the normal distribution N(b, u) folded at zero, 1.96 u without a bias and
|b| + 1.64 u beside a large one.  Where something was found it also holds all of the extended model's own interval.
Where the extended model does without the compliance of a joint, because other effects explain what it would, all of c
may be bias.
Source: GUM (JCGM 100:2008), F.2.4.5, on a known bias that is not corrected; the folded normal distribution.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.special import ndtr

from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.result.estimate import Identification, JointStiffness
from calibration_core.identification.result.observability import TWO_SIDED, at_least, joint_stiffness

PROBABILITY = 0.95
ROUNDING = 1e-12  # of a quantile
EXPLAINED = "other effects that were found explain what its compliance would explain"


def with_bias(found: Identification, searched: Diagnosis) -> Identification:
    """Return the identification with intervals that include the bias, and the extended model's stiffness beside.

    Nothing changes where the search knows no covariance of the compliances, at joints that neither model determines or
    that are declared rigid, and for positions at rest of which nothing is left out: there both models
    fit every stated stiffness.
    """
    covariance = searched.compliance_covariance
    holds = found.kind == "absolute" and searched.verdict == "consistent"
    if covariance is None or len(found.stiffness) != len(covariance) or holds:
        return found
    variances = np.clip(np.diag(covariance), 0.0, None)
    left_out = bool(searched.findings)
    rows = [
        _widened(joint, float(value), float(np.sqrt(variance)), beside=left_out)
        for joint, value, variance in zip(found.stiffness, searched.compliance, variances, strict=True)
    ]
    std = {f"compliance.{row.joint}": row.compliance_std for row in rows if row.identifiable}
    return dataclasses.replace(found, stiffness=tuple(rows), estimate=found.estimate.with_std(std))


def _widened(joint: JointStiffness, compliance: float, std: float, *, beside: bool) -> JointStiffness:
    if not (math.isfinite(joint.compliance_std) and joint.compliance_std > 0 and std > 0):
        return joint
    if not math.isfinite(std):
        return _all_bias(joint) if beside and compliance == 0 else joint
    own = joint_stiffness(
        joint.joint, compliance, std, identifiable=joint.identifiable, reason=joint.reason, unit=joint.unit
    )
    spread = max(std, joint.compliance_std)
    half = spread * half_width(abs(joint.compliance - compliance) / spread)
    wide = joint_stiffness(
        joint.joint,
        joint.compliance,
        half / TWO_SIDED,
        identifiable=joint.identifiable,
        reason=joint.reason,
        unit=joint.unit,
    )
    if not beside:
        return wide
    return dataclasses.replace(wide, interval=_union(wide.interval, own.interval), extended=own)


def half_width(bias: float) -> float:
    """Return the size, in standard deviations, that a normal value about `bias` stays below with 95 % probability.

    Found by Newton's method; it exceeds the bias by 1.64 (the quantile of one side) to 1.96 (that of two).

    Args:
        bias: Not negative, in standard deviations.
    """
    beyond, step = TWO_SIDED, math.inf
    while abs(step) > ROUNDING:
        other = beyond + 2 * bias
        density = math.exp(-beyond * beyond / 2) + math.exp(-other * other / 2)
        step = (PROBABILITY - float(ndtr(beyond) - ndtr(-other))) * math.sqrt(2 * math.pi) / density
        beyond += step
    return bias + beyond


def _all_bias(joint: JointStiffness) -> JointStiffness:
    """Return the stiffness of a joint of which the extended model has no compliance: its least value is known alone."""
    half = joint.compliance + TWO_SIDED * joint.compliance_std
    wide = joint_stiffness(joint.joint, joint.compliance, half / TWO_SIDED, unit=joint.unit)
    reason = f"{EXPLAINED}: {at_least(wide.interval[0], joint.unit)}"
    return dataclasses.replace(wide, identifiable=False, reason=reason)


def without_compliance(joint: JointStiffness) -> JointStiffness:
    """Return what the extended model says of a joint whose compliance it does without: nothing."""
    return joint_stiffness(joint.joint, 0.0, math.inf, identifiable=False, reason=EXPLAINED, unit=joint.unit)


def _union(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    return min(one[0], other[0]), max(one[1], other[1])
