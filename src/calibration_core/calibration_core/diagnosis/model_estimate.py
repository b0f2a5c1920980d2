"""What a diagnosis accepted, with its joint covariance, under the names of the model file.

Table 2 with the bias of what the standard's model leaves out.

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
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from calibration_core.cell import Cell
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.estimation.hypotheses import is_axial
from calibration_core.estimation.refit import Extended
from calibration_core.identification.geometry.parameter_table import (
    COMPLIANCE,
    in_coordinates,
    in_model_file,
    named_estimate,
    without_unknown,
)
from calibration_core.identification.geometry.terms import names_of
from calibration_core.identification.result.estimate import Identification, JointStiffness
from calibration_core.identification.result.observability import TWO_SIDED, at_least, joint_stiffness
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D


def loaded_estimate(
    extended: ExtendedLoadedModel, identification: Identification, model: ModelParameters, cell: Cell
) -> GaussianEstimate:
    """Return compliances and effects of a loaded recording together, and beside them tracker pose and points.

    A compliance of which the null model says nothing stays unknown.
    """
    n = len(model.joints)
    null = identification.estimate
    unknown = {name for name in null.unknown if name.startswith("compliance.")}
    names = tuple(f"{COMPLIANCE}{joint}" for joint in model.joints)
    covariance = extended.covariance.copy()
    for j, joint in enumerate(model.joints):
        if f"compliance.{joint}" in unknown:
            covariance[j, j] = np.inf
    chosen = [extended.design.candidates[index] for index in extended.accepted]
    together = _with_effects(names, covariance, chosen, extended.value, model, cell, n)
    others = [k for k, name in enumerate(null.names) if not name.startswith("compliance.")]
    return GaussianEstimate.independent((together, null.chosen(others)))


def positions_estimate(
    extended: Extended, model: ModelParameters, effects: Sequence[int], cell: Cell
) -> GaussianEstimate:
    """Return frames, geometry, compliances and effects of positions, at rest and under load, together.

    Args:
        extended: The extended model.
        model: What is written.
        effects: Parts of the extended model that stand in it as effects, in its order; compliances of joints that
            stand in the model itself follow the geometry, targets that moved are left out.
        cell: The cell file.
    """
    fitted, covariance = in_coordinates(extended.parameters, names_of(extended.model.terms), extended.covariance)
    sagging = [k for k, part in enumerate(extended.parts) if is_axial(part.candidate) and k not in effects]
    joints = [one.location["joint"] for one in extended.model.fitted_compliances]
    joints += [extended.parts[k].candidate.location["joint"] for k in sagging]
    names = (*fitted, *(f"{COMPLIANCE}{joint}" for joint in joints))

    def rows(part: int) -> Float1D:
        block = extended.block(part)
        return np.arange(extended.flat + block.start, extended.flat + block.stop)

    order = np.concatenate([np.arange(extended.flat), *map(rows, (*sagging, *effects))]).astype(int)
    chosen = [extended.parts[k].candidate for k in effects]
    beyond = (extended.value[extended.block(k)] - extended.held[extended.block(k)] for k in effects)
    value = np.concatenate([np.zeros(0), *beyond])
    return _with_effects(names, covariance[np.ix_(order, order)], chosen, value, model, cell, len(names))


def positions_compliance(extended: Extended) -> tuple[Float1D, Float2D]:
    """Return the compliances of positions, (n,) rad/(N*m), those that were found among them, and their covariance.

    The variance of a compliance that was not fitted is infinite.
    """
    joints, fitted = extended.parameters.joints, extended.model.fitted_compliances
    first = extended.flat - len(fitted)
    place = {str(one.location["joint"]): first + k for k, one in enumerate(fitted)}
    for k, part in enumerate(extended.parts):
        if is_axial(part.candidate):
            place[str(part.candidate.location["joint"])] = extended.flat + extended.block(k).start
    own, rows = [joints.index(name) for name in place], list(place.values())
    covariance = np.diag(np.full(len(joints), np.inf))
    covariance[np.ix_(own, own)] = extended.covariance[np.ix_(rows, rows)]
    return extended.parameters.compliance, covariance


def _with_effects(
    names: Sequence[str],
    covariance: Float2D,
    chosen: Sequence[Candidate],
    value: Float1D,
    model: ModelParameters,
    cell: Cell,
    count: int,
) -> GaussianEstimate:
    """Return the estimate of `count` named parameters and those of effects after them, in the order of the model."""
    covariance = without_unknown(covariance)
    base = named_estimate(names, covariance[:count, :count], model, cell)
    rows = [*in_model_file(names, cell), *range(count, len(covariance))]
    effects = [(f"effects.{k}.{p.name}", p.unit) for k, one in enumerate(chosen) for p in one.parameters]
    return GaussianEstimate(
        (*base.names, *(name for name, _ in effects)),
        (*base.units, *(unit for _, unit in effects)),
        np.concatenate([base.value, value]),
        covariance[np.ix_(rows, rows)],
    )


# --- table 2 with the bias of what the standard's model leaves out ----------------------------------------------------


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
