"""What a diagnosis accepted, with its joint covariance, under the names of the model file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.estimation.hypotheses import is_axial
from calibration_core.estimation.refit import Extended
from calibration_core.identification.geometry.named_estimate import (
    COMPLIANCE,
    in_model_file,
    named_estimate,
    without_unknown,
)
from calibration_core.identification.geometry.parameter_table import in_coordinates
from calibration_core.identification.geometry.terms import names_of
from calibration_core.identification.result.estimate import Identification
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
