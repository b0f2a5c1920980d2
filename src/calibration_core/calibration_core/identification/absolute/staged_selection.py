"""Staged model selection for absolute recordings: nominal, frames, geometry, elasticity, as far as held-out data go.

Whether absolute positions show joints giving way under gravity, or something that only looks like it.

A compliance column lowers almost any residual a little.  It is believed only if held-out configurations gain clearly,
if most of that gain is lost when gravity is turned by 90 degrees, and if it is not the first harmonic of the same
joints' transmissions in disguise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.errors import EquilibriumError
from calibration_core.identification.absolute.prediction_error import Improvement, LinearModel, compare, held_out
from calibration_core.identification.geometry.fit import AbsoluteProblem, GeometryFit, Prior, fit, normal_equations
from calibration_core.identification.geometry.identifiability import LEAST_REST, ParameterSelection, columns_rest
from calibration_core.identification.geometry.parameter_table import GaussianPrior
from calibration_core.identification.geometry.terms import ElasticityTerm, HarmonicTerm, Term
from calibration_core.identification.result.estimate import Stage
from calibration_core.identification.statistics import rms_length
from calibration_core.model.effects.absolute.joint_elasticity import turned
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

COLLAPSED = 1 / 3  # share of the gain that the best control may keep: most of it must go
UNLOADED = 1e-6  # length of a joint's column, relative to the longest, below which gravity does not load it


@dataclasses.dataclass(frozen=True)
class ElasticityVerdict:
    """What the linearised comparison says.

    Attributes:
        joints: Joints whose compliance improves held-out configurations clearly, counted from 0, best first.
        loaded: Joints that gravity loads.
        believed: Whether the claim survives both controls.
        rms: 3-d root mean square of the linearised model with these compliances, m.
        held_out_rms: The same on configurations left out, m.
    """

    joints: tuple[int, ...]
    loaded: tuple[int, ...]
    believed: bool
    reason: str
    rms: float
    held_out_rms: float


def judge_elasticity(
    problem: AbsoluteProblem, geometry: GeometryFit, fold: Int1D, configuration: Int1D
) -> ElasticityVerdict:
    """Test axial joint compliances under gravity against held-out configurations and two controls.

    Everything is linearised once at the geometric solution (sag is a few thousandths of the lengths, so what is left
    out is a few thousandths of the sag).  Joints are taken one by one, the one with the largest gain first, as long as
    the gain is clear (`Improvement.clear`); where none is clear alone, all of them together.  The controls are given
    every freedom: either sign, where compliances are bound to be positive; each harmonic two amplitudes per joint.

    Args:
        problem: The readings used.
        geometry: The geometric fit.
        fold: (m,) fold of every reading.
        configuration: (m,) configuration of every reading.
    """
    n = problem.chain.n
    joints = tuple(range(n))
    sideways = [tuple(gravity.tolist()) for gravity in turned(problem.chain.gravity)]
    blocks: list[Term] = [
        *geometry.terms,
        ElasticityTerm(joints, tuple(f"C{j}" for j in joints)),
        *(
            ElasticityTerm(joints, tuple(f"{k}C{j}" for j in joints), g, either_sign=True)
            for k, g in enumerate(sideways)
        ),
        HarmonicTerm(joints),
    ]
    model = LinearModel(problem, geometry.parameters, blocks, fold)
    base = list(range(len(geometry.names)))
    real = len(base)
    before = model.held_out(base)
    loaded = tuple(_loaded(model, real, n))
    chosen, after = _choose_joints(model, base, real, loaded, before, configuration)
    if not chosen:
        chosen = tuple(column - real for column in _sound(model, base, [real + j for j in loaded]))
        after = model.held_out([*base, *(real + j for j in chosen)])
    main = compare(before, after, configuration)
    fitted = rms_length(model.fitted([*base, *(real + j for j in chosen)]).T)
    if not chosen or not main.clear:
        reason = f"no joint's compliance helps clearly; all together: {main.text}"
        return ElasticityVerdict(chosen, loaded, believed=False, reason=reason, rms=fitted, held_out_rms=main.after)
    others = [_sound(model, base, [real + (k + 1) * n + j for j in chosen]) for k in range(len(sideways))]
    controls = [model.held_out([*base, *columns]) for columns in others]
    gains = [compare(before, control, configuration).gain for control in controls]
    best = int(np.argmax(gains))
    kept = max(gains[best], 0.0) / main.gain
    against = compare(controls[best], after, configuration)
    first = real + (1 + len(sideways)) * n
    waves = [*base, *_sound(model, base, [first + 2 * j + part for j in chosen for part in (0, 1)])]
    wave = model.held_out(waves)
    beyond = compare(wave, model.held_out([*waves, *(real + j for j in chosen)]), configuration)
    names = ", ".join(problem.chain.joints[j] for j in chosen)
    reason = (
        f"{names}: {main.text}; with gravity turned by 90 degrees {100 * kept:z.0f} % of the gain remains; "
        f"beyond the first harmonic of these joints' own angles: {beyond.text}"
    )
    collapses = kept <= COLLAPSED and against.clear
    if not collapses:
        reason = f"{reason}: the gain does not collapse, so it is not gravity's"
    elif not beyond.clear:
        reason = f"{reason}: it cannot be distinguished from a harmonic of the transmission"
    return ElasticityVerdict(chosen, loaded, collapses and beyond.clear, reason, fitted, main.after)


def _choose_joints(
    model: LinearModel, base: list[int], real: int, loaded: Sequence[int], before: Float2D, configuration: Int1D
) -> tuple[tuple[int, ...], Float2D]:
    """Return the joints that gain clearly, one after another, and the held-out residuals with them."""
    open_joints = list(loaded)
    chosen: list[int] = []
    current = before
    while open_joints:
        taken = [*base, *(real + j for j in chosen)]
        sound = [j for j in open_joints if _sound(model, taken, [real + j])]
        trials = {j: model.held_out([*taken, real + j]) for j in sound}
        gains = {j: compare(current, trial, configuration) for j, trial in trials.items()}
        clear = [j for j in sound if gains[j].clear]
        if not clear:
            break
        best = max(clear, key=lambda j: gains[j].gain)
        chosen.append(best)
        open_joints.remove(best)
        current = trials[best]
    return tuple(chosen), current


def _loaded(model: LinearModel, real: int, n: int) -> list[int]:
    """Return the joints that gravity loads."""
    length = np.sqrt(np.diag(model.matrix)[real : real + n])
    return [j for j in range(n) if length[j] > UNLOADED * max(float(length.max()), 1e-300)]


def _sound(model: LinearModel, base: Sequence[int], offered: Sequence[int]) -> list[int]:
    """Return those of the offered columns that the base and each other do not explain."""
    taken: list[int] = []
    for column in offered:
        index = [*base, *taken, column]
        matrix = model.matrix[np.ix_(index, index)]
        if matrix[-1, -1] > 0 and columns_rest(matrix, len(index) - 1) >= LEAST_REST:
            taken.append(column)
    return taken


# --- staged model selection for absolute recordings -------------------------------------------------------------------


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
    because the cell file's are nominal.  Geometry is judged with the elasticity that the recording proves beside it and
    without it: a wrong compliance does not become geometry, and none hides it.

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
    sags, sagging, sagging_joints = _elasticity(case, frames)
    geometry = case.fit_stage(frames.fit.parameters, [*frame_terms, choice.term])
    bends, bending, bending_joints = _elasticity(case, geometry)
    gain = case.improvement(sagging or frames, bending or geometry)
    kept = gain.clear and geometry.fit.converged
    verdict = "kept" if kept else "not kept: no clear gain on configurations left out"
    if not kept and corrected and geometry.fit.converged:
        kept, verdict = True, "kept as asked"
    counted = f"{len(choice.chosen)} identifiable parameters, {len(choice.nominal)} stay nominal"
    beside = "; with elasticity on both sides" if sagging else "; with elasticity" if bending else ""
    reason = f"{counted}; {gain.text}{beside}; {verdict}"
    stages.append(Stage("geometry", _size(geometry), geometry.rms, geometry.held_out_rms, kept, reason))
    if kept:
        return StagedSelection((*stages, bends), frames, bending or geometry, bending_joints)
    return StagedSelection((*stages, sags), frames, sagging or frames, sagging_joints)


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
