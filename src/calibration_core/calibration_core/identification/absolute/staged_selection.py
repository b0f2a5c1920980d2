"""Staged model selection for absolute recordings: nominal, frames, geometry, elasticity, as far as held-out data go."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.errors import EquilibriumError
from calibration_core.identification.absolute.elasticity import judge_elasticity
from calibration_core.identification.absolute.prediction_error import Improvement, compare, held_out
from calibration_core.identification.geometry.fit import AbsoluteProblem, GeometryFit, Prior, fit, normal_equations
from calibration_core.identification.geometry.identifiability import ParameterSelection
from calibration_core.identification.geometry.prior import GaussianPrior
from calibration_core.identification.geometry.terms import ElasticityTerm, Term
from calibration_core.identification.result.estimate import Stage
from calibration_core.identification.statistics.sizes import rms_length
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

NO_GEOMETRY = "the geometry is not identified"


@dataclasses.dataclass(frozen=True, eq=False)
class FittedStage:
    """A stage whose model was fitted.

    Attributes:
        fit: The fit to the readings used.
        residual: (3, m) m, base axes, all readings.
        held_out: (3, m) m, every configuration predicted from the others.
    """

    fit: GeometryFit
    residual: Float2D
    held_out: Float2D

    @property
    def rms(self) -> float:
        """3-d root mean square over all readings, m."""
        return rms_length(self.residual.T)

    @property
    def held_out_rms(self) -> float:
        """The same on held-out configurations, m."""
        return rms_length(self.held_out.T)


@dataclasses.dataclass(frozen=True, eq=False)
class StagedSelection:
    """The stages, and the model that the recording supports.

    Attributes:
        stages: What was tried, in order.
        frames: The model with frames only.
        final: The model that is kept.
        elastic: Joints whose compliance is kept, counted from 0.
    """

    stages: tuple[Stage, ...]
    frames: FittedStage
    final: FittedStage
    elastic: tuple[int, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class SelectionCase:
    """What every stage needs.

    Attributes:
        problem: All readings.
        used: (m,) readings that may be fitted.
        fold: (m,) fold of every reading.
        configuration: (m,) its configuration.
        uncertainty: (n,) rad/(N*m), standard uncertainty of the compliances that are stated; 0: taken as they are.
    """

    problem: AbsoluteProblem
    used: Bool1D
    fold: Int1D
    configuration: Int1D
    uncertainty: Float1D

    def fit_stage(self, start: ModelParameters, terms: list[Term], prior: Prior | None = None) -> FittedStage:
        """Fit the terms to the readings used, and predict every configuration from the others."""
        used = self.problem.select(np.flatnonzero(self.used))
        if terms:
            result = fit(used, start, terms, prior)
        else:
            result = GeometryFit(start, (), normal_equations(used, start, ()), 0, converged=True)
        residual = self.problem.residual(result.parameters)
        return FittedStage(result, residual, held_out(self.problem, result, self.fold, self.used))

    def improvement(self, before: FittedStage, after: FittedStage) -> Improvement:
        """Compare two models on the readings used."""
        return compare(before.held_out[:, self.used], after.held_out[:, self.used], self.configuration[self.used])


def select_stages(
    case: SelectionCase,
    nominal: ModelParameters,
    start: ModelParameters,
    frame_terms: list[Term],
    choice: ParameterSelection,
    *,
    corrected: bool = False,
) -> StagedSelection:
    """Add frames, geometry and elasticity, each kept only if held-out configurations gain clearly.

    The rule is `Improvement.clear`, for elasticity with the controls of `elasticity`; the frames are kept always,
    because the cell file's are nominal.  Geometry that gains nothing clearly by itself is kept
    where it does so together with elasticity, which may hide it.

    Args:
        case: Readings, folds.
        nominal: What the cell file predicts.
        start: First guess of the frames.
        frame_terms: Tracker pose and points.
        choice: The corrections of the geometry that can be identified.
        corrected: Keep them whatever they gain.
    """
    first = case.fit_stage(nominal, [])
    frames = case.fit_stage(start, frame_terms)
    gain = case.improvement(first, frames)
    stages = [
        Stage("nominal", 0, first.rms, first.held_out_rms, kept=True, reason="what the cell file predicts"),
        Stage("frames", _size(frames), frames.rms, frames.held_out_rms, True, f"{gain.text}; always refitted"),
    ]
    if not choice.chosen:
        reason = "these configurations distinguish no geometric parameter from the frames"
        stages += [_not_tried("geometry", frames, reason), _not_tried("elasticity", frames, NO_GEOMETRY)]
        return StagedSelection(tuple(stages), frames, frames, ())
    geometry = case.fit_stage(frames.fit.parameters, [*frame_terms, choice.term])
    gain = case.improvement(frames, geometry)
    kept = gain.clear and geometry.fit.converged
    verdict = "kept" if kept else "not kept: no clear gain on configurations left out"
    stage, elastic, joints = _elasticity(case, geometry)
    if not kept and elastic is not None:  # what gives way under its weight may hide the geometry
        both = case.improvement(frames, elastic)
        kept, verdict = both.clear, f"no clear gain by itself; with elasticity: {both.text}"
    if not kept and corrected and geometry.fit.converged:
        kept, verdict = True, "kept as asked"
    counted = f"{len(choice.chosen)} identifiable parameters, {len(choice.nominal)} stay nominal"
    reason = f"{counted}; {gain.text}; {verdict}"
    stages.append(Stage("geometry", _size(geometry), geometry.rms, geometry.held_out_rms, kept, reason))
    if not kept:
        stages.append(_not_tried("elasticity", frames, NO_GEOMETRY))
        return StagedSelection(tuple(stages), frames, frames, ())
    return StagedSelection((*stages, stage), frames, geometry if elastic is None else elastic, joints)


def _elasticity(case: SelectionCase, geometry: FittedStage) -> tuple[Stage, FittedStage | None, tuple[int, ...]]:
    if not case.problem.loaded:
        unknown = "the cell file states no inertials, so gravity's torques are unknown"
        return _not_tried("elasticity", geometry, unknown), None, ()
    rows = np.flatnonzero(case.used)
    verdict = judge_elasticity(case.problem.select(rows), geometry.fit, case.fold[rows], case.configuration[rows])
    size = _size(geometry) + len(verdict.joints)
    if not verdict.believed:
        return Stage("elasticity", size, verdict.rms, verdict.held_out_rms, kept=False, reason=verdict.reason), None, ()
    joints = tuple(sorted(verdict.joints))
    stated = tuple(j for j in verdict.loaded if case.uncertainty[j] > 0 and j not in joints)
    try:
        elastic = case.fit_stage(geometry.fit.parameters, _bending(geometry, joints))
        kept = elastic.fit.converged and case.improvement(geometry, elastic).clear
        if kept and stated:  # what no gain proves is uncertain all the same, and so are the others by it
            terms = _bending(geometry, (*joints, *stated))
            known = np.concatenate([np.zeros(size), case.uncertainty[list(stated)] ** -2.0])
            prior = GaussianPrior(geometry.fit.parameters, tuple(terms), np.diag(known))
            elastic = case.fit_stage(elastic.fit.parameters, terms, prior)
            kept = elastic.fit.converged
    except EquilibriumError as error:
        reason = f"{verdict.reason}; but the springs do not carry the robot: {error}"
        return Stage("elasticity", size, verdict.rms, verdict.held_out_rms, kept=False, reason=reason), None, ()
    remark = "" if kept else "; but with the equilibrium on the deformed geometry no clear gain is left"
    reason = verdict.reason + remark
    stage = Stage("elasticity", _size(elastic), elastic.rms, elastic.held_out_rms, kept, reason)
    return (stage, elastic, joints) if kept else (stage, None, ())


def _bending(geometry: FittedStage, joints: tuple[int, ...]) -> list[Term]:
    names = geometry.fit.parameters.joints
    return [*geometry.fit.terms, ElasticityTerm(joints, tuple(f"C {names[j]}" for j in joints))]


def _not_tried(name: str, current: FittedStage, reason: str) -> Stage:
    return Stage(name, _size(current), current.rms, current.held_out_rms, kept=False, reason=f"not tried: {reason}")


def _size(stage: FittedStage) -> int:
    return len(stage.fit.names)
