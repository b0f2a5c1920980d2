"""Compliances of joints whose law is open: as uncertain as the law moves the points.

Where a joint follows a law that the catalogue does not have, its deflection over its torque is another one at every
load.  What is called its compliance depends on which law is taken, by about as much as the law adds to what a spring of
constant stiffness does.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from calibration_core.diagnosis.empirical.law import Law
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.evidence.selection import LoadedSelection
from calibration_core.diagnosis.result.finding import Finding
from calibration_core.estimation.hypotheses import LAW
from calibration_core.estimation.refit import Extended
from calibration_core.identification.statistics.sizes import rms_length
from calibration_core.model.effects.absolute import approach_direction
from calibration_core.model.effects.candidate import Candidate
from calibration_core.timeseries import Float2D


def with_open_laws(extended: ExtendedLoadedModel, selection: LoadedSelection, law: Law | None) -> ExtendedLoadedModel:
    """Return the model with compliances as uncertain as the laws of their joints are open.

    Args:
        extended: The extended model.
        selection: What was accepted; a law that needs refinements is of another form than the catalogue's.
        law: An empirical law for what no physics explains; None: there is none.
    """
    open_ones = (*_unsettled(extended, selection), *_empirical(law))
    if not open_ones:
        return extended
    state, compliance = extended.state, extended.compliance
    columns = extended.problem.linearise(extended.base_compliance).columns
    more = np.zeros(len(compliance))
    for joint, shift in open_ones:
        moved = rms_length(state.since_step_zero(columns[:, :, joint] * compliance[joint]))
        if moved > 0:
            more[joint] = max(more[joint], compliance[joint] * rms_length(shift) / moved)
    covariance = extended.covariance.copy()
    n = len(compliance)
    covariance[np.arange(n), np.arange(n)] += more**2
    return dataclasses.replace(extended, covariance=covariance)


def with_open_joints(extended: Extended, findings: Sequence[Finding]) -> Extended:
    """Return the model of positions with compliances as uncertain as the laws of their joints are open.

    A joint that lags under changing loads stands elsewhere by the direction from which it came, too.

    Args:
        extended: The extended model, loads and postures at rest in one.
        findings: What was found; of some the form of the law is not settled.
    """
    compliances = [str(one.location["joint"]) for one in extended.model.fitted_compliances]
    covariance = extended.covariance.copy()
    for one in findings:
        joint = one.location.get("joint")
        if one.law_settled or not _is_law(one) or joint not in compliances:
            continue
        column = extended.flat - len(compliances) + compliances.index(joint)
        law = [
            k
            for k, part in enumerate(extended.parts)
            if _is_law(part.candidate) and part.candidate.location == one.location
        ]
        compliance = float(extended.parameters.compliance[extended.parameters.joints.index(joint)])
        by_load = extended.model.state.since_step_zero(extended.moved_by(column) * compliance)
        loaded = np.any(by_load != 0, axis=1)
        if loaded.any():
            share = rms_length(extended.shift(law)[loaded]) / rms_length(by_load[loaded])
            covariance[column, column] += (compliance * share) ** 2
    return dataclasses.replace(extended, covariance=covariance)


def _is_law(one: Finding | Candidate) -> bool:
    return one.family == LAW or one.effect == approach_direction.EFFECT.name


def _unsettled(extended: ExtendedLoadedModel, selection: LoadedSelection) -> Iterator[tuple[int, Float2D]]:
    """Yield the joint and the (m, 3) m of each law that was found there with refinements."""
    for choice in selection.choices:
        own = extended.design.candidates[choice.candidate]
        if own.family == LAW and choice.refinements:
            joint = extended.state.chain.joints.index(str(own.location["joint"]))
            yield joint, extended.moved((choice.candidate, *choice.refinements))


def _empirical(law: Law | None) -> Iterator[tuple[int, Float2D]]:
    """Yield the joint and the (m, 3) m of each term of an empirical law."""
    for one in () if law is None else law.terms:
        yield one.term.joint, one.shift
