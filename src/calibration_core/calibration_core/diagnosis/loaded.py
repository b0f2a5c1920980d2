"""Diagnosis of a loaded recording: null model, selection, re-linearised extended model, what remains."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.data_checks.loaded_anomalies import (
    Checked,
    check_each,
    noise_understated,
    outlier_readings,
)
from calibration_core.diagnosis.data_checks.noise import (
    Scatter,
    claimed,
    directions,
    moved_with_their_step,
    readings_to_use,
    scatter,
    whole_steps,
    with_noise,
)
from calibration_core.diagnosis.empirical import empirical_law, law_findings, law_sentence, with_open_laws
from calibration_core.diagnosis.evidence.design import LoadedSelection, select
from calibration_core.diagnosis.evidence.extended import (
    ExtendedLoadedModel,
    aliases,
    beside_small_effects,
    design_at,
    extend,
    extended_model,
    loaded_state,
    with_alternatives,
)
from calibration_core.diagnosis.evidence.residual import (
    Jumps,
    held_out_lengths,
    held_out_ratio,
    jumps_along_a_joint,
    scattered_covariance,
    weighted_rest,
    what_remains,
)
from calibration_core.diagnosis.findings.loaded import (
    RejectedCandidate,
    findings_of,
    registration,
    rejected_candidates,
    rejection_sentence,
)
from calibration_core.diagnosis.model_estimate import loaded_estimate
from calibration_core.diagnosis.proposals.choose import NONE_ASKED, Offers, choose
from calibration_core.diagnosis.proposals.postures import LoadedKnowledge
from calibration_core.diagnosis.result.finding import Diagnosis, Rest, by_size
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.result.estimate import Anomaly, Identification
from calibration_core.identification.result.tested import MISFIT
from calibration_core.identification.several.mixed import BothFits
from calibration_core.identification.statistics import Rows, rms, without_offsets
from calibration_core.identification.stiffness.loaded import (
    Options,
    PreparedLoaded,
    identify_prepared,
    prepare_loaded,
    refitted_frames,
)
from calibration_core.identification.stiffness.problem import LoadedProblem
from calibration_core.identification.stiffness.tested import tested_on
from calibration_core.model.effects import candidates, effects_with
from calibration_core.model.effects.candidate import Candidate, Trait
from calibration_core.observations.average import coordinate_std
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings

ROUNDS = 3
SETTLED = 0.05  # relative change of the noise below which it is taken as found
LISTED = 12  # steps that are named
MOVED = 0.05  # relative change of a compliance below which the operating point is taken as found
FRAMES_SPOILED = frozenset({"target_moved", "tracker_moved"})


@dataclasses.dataclass(frozen=True, eq=False)
class Attempt:
    """One pass: noise, all readings' rows with it, what was selected, the model extended by it, what was rejected, and
    the null model's rms, m.
    """

    seen: Scatter
    rows: Rows
    selection: LoadedSelection
    extended: ExtendedLoadedModel
    rejected: tuple[RejectedCandidate, ...]
    rms_before: float


def diagnose_loaded(
    readings: Readings,
    cell: Cell,
    options: Options | None = None,
    test: Readings | None = None,
    offers: Offers | None = None,
    identified: Identification | None = None,
) -> Diagnosis:
    """Say what the model of a loaded recording leaves out; arguments as `diagnose`, errors as `prepare_loaded`."""
    options = options or Options()
    basis = None if identified is None else identified.basis
    loaded = basis.loaded if isinstance(basis, BothFits) else basis
    if identified is not None and isinstance(loaded, PreparedLoaded):
        prepared, identification = loaded, identified
    else:
        prepared = prepare_loaded(readings, cell, options)
        identification = identify_prepared(prepared, cell, options, test)
    checked = check_each(prepared, lambda problem: loaded_state(problem, cell, prepared.fit.compliance))
    attempt = _search(prepared, cell, options, checked)
    extended, selection, seen = attempt.extended, attempt.selection, attempt.seen
    rest = what_remains(extended, seen, identification.noise.claimed, prepared.problem.readings)
    if attempt.rejected:
        joints, kept = prepared.problem.chain.joints, prepared.problem.readings
        sentences = " ".join(rejection_sentence(one, joints, kept) for one in attempt.rejected)
        size = (
            rest.text
            if rest.significant
            else "The residual is no larger than noise, but it follows something, which noise does not."
        )
        rest = dataclasses.replace(rest, significant=True, text=f"{size} {sentences}")
    rest = _with_left_out(rest, attempt)
    rest = _with_whole_steps(rest, extended, checked)
    law = empirical_law(extended) if rest.significant else None
    jumps = _jumps(prepared, extended, seen)
    rest = _with_jumps(rest, prepared, jumps)
    anomalies = _anomalies(checked, attempt, identification, jumps)
    findings = findings_of(extended, selection, identification, readings)
    if not {anomaly.kind for anomaly in checked.anomalies} & FRAMES_SPOILED:
        frames = _frames_beside(prepared, extended, cell)
        registered, notes = registration(prepared, extended.state, readings, frames, cell.frames.sigma_points)
        findings = by_size((*findings, *registered))
        identification = dataclasses.replace(identification, notes=(*identification.notes, *notes))
    verdict = rest.verdict(found=bool(findings))
    if law is not None:
        fitted = law_findings(law, prepared.problem.chain.joints, prepared.problem.readings)
        findings = by_size((*findings, *fitted))
        rest = dataclasses.replace(rest, text=f"{rest.text} {law_sentence(law)}")
    extended = with_open_laws(extended, selection, law)
    unit = identification.noise.claimed * seen.total  # of one whitened row
    before, after = (held_out_lengths(extended, cell, accepted) for accepted in ((), extended.accepted))
    joints = prepared.problem.chain.joints
    model = extended_model(prepared.parameters, extended) if extended.accepted else None
    proposals = NONE_ASKED
    if offers is not None:
        known = LoadedKnowledge(extended, selection, offers, cell, seen, prepared)
        proposals = choose(known, offers.each)
    return Diagnosis(
        verdict=verdict,
        findings=findings,
        anomalies=anomalies,
        rest=rest,
        next_measurements=proposals.measurements,
        next_text=proposals.text,
        identification=identification,
        stiffness={
            joint: (1 / c, s / c**2) if c > 0 else (np.inf, np.inf)
            for joint, c, s in zip(joints, extended.compliance, extended.compliance_std, strict=True)
        },
        rms_before=attempt.rms_before,
        rms_after=rms(extended.residual),
        held_out_before=float(np.sqrt(np.mean(before**2) / 3)),
        held_out_after=float(np.sqrt(np.mean(after**2) / 3)),
        noise=unit if seen.freedom else identification.noise.claimed,  # what a model leaves is no noise
        level=selection.level,
        located=(),
        residual=_without_offsets(extended, extended.raw),
        residual_before=_without_offsets(extended, prepared.problem.linearise(prepared.fit.compliance).residual),
        shift=extended.shift,
        compliance=extended.compliance,
        compliance_covariance=scattered_covariance(extended) if rest.significant else extended.compliance_covariance,
        test=None
        if test is None
        else tested_on(test, cell, model or prepared.parameters, prepared.parameters, with_frames=False),
        model=model,
        estimate=identification.estimate if model is None else loaded_estimate(extended, identification, model, cell),
        aliases=aliases(extended.state, differences=True),
        further_figures={
            "held_out_mean_before": float(before.mean()),
            "held_out_max_before": float(before.max()),
            "held_out_mean_after": float(after.mean()),
            "held_out_max_after": float(after.max()),
        },
    )


def _frames_beside(prepared: PreparedLoaded, extended: ExtendedLoadedModel, cell: Cell) -> FrameFit | None:
    """Return the frames, fitted once more less what the findings move under the robot's own weight.

    A base that gives way tilts the robot in all configurations, as a tracker that stands elsewhere does.
    """
    if prepared.frames is None or not extended.accepted:
        return prepared.frames
    several = ((extended.design.candidates[k], extended.values_of(k)[0]) for k in extended.accepted)
    moved = sum((one.columns(extended.state) @ value for one, value in several), np.zeros((extended.state.m, 3)))
    return refitted_frames(prepared, cell, extended.compliance, moved, extended.used)


def _with_left_out(rest: Rest, attempt: Attempt) -> Rest:
    """Say of configurations left out that the model predicts them worse than noise and usual errors would have it."""
    seen, noise = attempt.seen, attempt.rows.noise
    ratio = held_out_ratio(attempt.extended.design, attempt.selection.accepted)
    times = ratio if seen.freedom else ratio * seen.total  # what a model leaves is no noise
    if rest.significant or times <= MISFIT:
        return rest
    size = coordinate_std(noise) * (1.0 if seen.freedom else 1 / seen.total)
    text = f"Configurations left out are predicted {times:.2f} times as badly as noise explains."
    return rest.also(text, rest.where, size * float(np.sqrt(times**2 - 1)))


def _with_whole_steps(rest: Rest, extended: ExtendedLoadedModel, checked: Checked) -> Rest:
    """Say of steps that were set aside whole that no gross error of the tracker explains them."""
    readings, rows = extended.problem.readings, extended.problem.linearise(extended.compliance).rows
    sound = np.flatnonzero(checked.sound)
    moved = whole_steps(readings, extended.state.point.T, extended.raw, rows.noise, extended.used, sound)
    if not len(moved):
        return rest
    steps = sorted({(int(readings.configuration[k]), int(readings.step[k])) for k in moved})
    listed = ", ".join(f"{configuration}/{step}" for configuration, step in steps[:LISTED])
    more = f" and {len(steps) - LISTED} more" if len(steps) > LISTED else ""
    text = (
        f"At some steps all points moved together, the tool's shape unchanged, to where the model does not expect them "
        f"(configuration/step {listed}{more}): that is no gross error of the tracker but the robot or the load."
    )
    return rest.also(text, dict(rest.where) or {"configurations": sorted({number for number, _ in steps})})


def _jumps(prepared: PreparedLoaded, extended: ExtendedLoadedModel, seen: Scatter) -> Jumps | None:
    """Return the joint that jumps from step to step follow, if they follow one."""
    if not seen.freedom:
        return None
    problem, used, axes = prepared.problem, extended.used, _axes(prepared)
    rows, answer = problem.linearise(extended.compliance).rows, extended.state.answer.transpose(2, 0, 1)
    readings = problem.readings.select(used)
    return jumps_along_a_joint(rows.select(used), extended.raw[used], readings, axes[used], answer[used], seen)


def _with_jumps(rest: Rest, prepared: PreparedLoaded, found: Jumps | None) -> Rest:
    """Say of jumps from step to step that follow one joint that they are no noise."""
    if found is None:
        return rest
    name = prepared.problem.chain.joints[found.joint]
    text = (
        f"From step to step the points jump by {1e6 * found.rms:.1f} µm rms more in the direction in which {name} "
        "moves them than in the others. The noise of the tracker has no such direction: the cause is at this joint, "
        "for example friction of another law than the catalogue's."
    )
    return rest.also(text, {**rest.where, "joints": {name: round(found.share, 3)}}, found.rms)


def _hypotheses(prepared: PreparedLoaded, cell: Cell) -> tuple[Candidate, ...]:
    """Return what could be missing; frames that absolute positions fix are refitted, no hypotheses."""
    found = candidates(loaded_state(prepared.problem, cell, prepared.fit.compliance))
    if prepared.frames is None:
        return found
    refitted = effects_with(Trait.FRAMES)
    return tuple(candidate for candidate in found if candidate.effect not in refitted)


def _anomalies(
    checked: Checked, attempt: Attempt, identification: Identification, jumps: Jumps | None
) -> tuple[Anomaly, ...]:
    extended = attempt.extended
    readings = extended.problem.readings
    aside = checked.sound.copy()
    aside[extended.used] = False
    length = np.linalg.norm(_without_offsets(extended, extended.raw), axis=1)
    size = float(length[aside].max(initial=0.0))
    kinds = {anomaly.kind for anomaly in checked.anomalies}
    seen = attempt.seen
    if jumps is not None:  # what a joint does is no noise of the tracker; of one point alone nothing else is seen
        seen = dataclasses.replace(
            seen, shared=0.0, least_shared=0.0, freedom=seen.freedom if len(readings.points) > 1 else 0
        )
    noise = () if kinds & {"loose_target"} else noise_understated(seen, identification.noise.claimed)
    notes = tuple(anomaly for anomaly in identification.anomalies if anomaly.kind == "unsettled")
    return (*checked.anomalies, *noise, *outlier_readings(aside, size, readings), *notes)


def _without_offsets(extended: ExtendedLoadedModel, residual: Float2D) -> Float2D:
    """Return the (m, 3) m residuals of all readings, offsets by those used taken out."""
    rows = extended.problem.linearise(extended.compliance).rows
    return without_offsets(rows.counting(extended.used), residual)


def _search(prepared: PreparedLoaded, cell: Cell, options: Options, checked: Checked) -> Attempt:
    """Search without the readings that the null model takes for gross errors; where some stay aside, with them, too.

    A law that the null model does not know moves some readings far, all points of a step together, which no gross error
    of a tracker does.  Left out, they cannot show the law.
    """
    sound = np.flatnonzero(checked.sound)
    first = _settled(prepared, cell, options, checked, np.flatnonzero(checked.sound & prepared.rejection.used))
    problem = prepared.problem
    aside = np.setdiff1d(sound, first.extended.used)
    rows = problem.linearise(prepared.fit.compliance).rows
    extended, readings = first.extended, problem.readings
    moved = moved_with_their_step(readings, extended.state.point.T, extended.raw, rows.noise, extended.used, aside)
    if not len(moved):
        return first
    again = _settled(prepared, cell, options, checked, np.union1d(extended.used, moved))
    explains = again.selection.accepted and len(again.extended.used) > len(extended.used)
    return again if explains else first


def _settled(prepared: PreparedLoaded, cell: Cell, options: Options, checked: Checked, used: Int1D) -> Attempt:
    """Select and extend until operating point, readings used and noise stand still.

    A strong missing effect spoils all three: the null model's compliances are wrong, good readings look bad under it,
    and the noise looks larger.  So each is taken again from the extended model.
    """
    problem, compliance = prepared.problem, prepared.fit.compliance
    hypotheses = _hypotheses(prepared, cell)
    axes = _axes(prepared)
    sound = np.flatnonzero(checked.sound)
    linear = problem.linearise(compliance)
    seen = _seen(linear.rows, linear.residual, problem, axes, used)
    noise_seen = seen.freedom > 0
    if not noise_seen:
        seen = claimed(max(1.0, float(np.sqrt(prepared.fit.chi2 / max(prepared.fit.freedom, 1)))))
    for remaining in reversed(range(ROUNDS)):
        attempt = _attempt(prepared, cell, hypotheses, seen, axes, used, compliance)
        extended = attempt.extended
        kept = sound
        if options.robust:
            step = problem.readings.step[sound]
            kept = sound[readings_to_use(attempt.rows.select(sound), extended.raw[sound], step)]
        again = _seen(linear.rows, extended.raw, problem, axes, kept) if noise_seen else _left(attempt)
        moved = float(np.abs(extended.compliance / np.where(compliance > 0, compliance, np.inf) - 1).max())
        still = abs(again.total / seen.total - 1) < SETTLED and moved < MOVED and np.array_equal(kept, used)
        if still or not remaining or not attempt.selection.accepted:
            whole = beside_small_effects(extended, cell, hypotheses, prepared.frames, attempt.selection)
            return dataclasses.replace(attempt, extended=with_alternatives(whole, attempt.selection))
        seen, used, compliance = again, kept, np.clip(extended.compliance, 0.2 * compliance, 3 * compliance)
    raise AssertionError  # the last round returns


def _attempt(
    prepared: PreparedLoaded,
    cell: Cell,
    hypotheses: tuple[Candidate, ...],
    seen: Scatter,
    axes: Float3D,
    used: Int1D,
    compliance: Float1D,
) -> Attempt:
    problem = prepared.problem
    whole = with_noise(problem.linearise(compliance).rows, problem.readings, seen, axes)
    rows = whole.select(used)
    _, design = design_at(problem, cell, compliance, rows, used, hypotheses, prepared.frames)
    selection = select(design, noise_known=seen.freedom > 0)
    extended = extend(problem, cell, compliance, rows, used, hypotheses, prepared.frames, selection)
    outdone = rejected_candidates(extended, selection)
    if outdone:
        selection = selection.without([one.choice for one in outdone])
        extended = extend(problem, cell, compliance, rows, used, hypotheses, prepared.frames, selection)
    return Attempt(seen, whole, selection, extended, outdone, _rms(used, prepared))


def _axes(prepared: PreparedLoaded) -> Float3D:
    """Return (m, 3, 3) the directions in which the tracker errs independently, of all readings."""
    tracker = None if prepared.frames is None else prepared.problem.parameters.tracker
    return directions(prepared.problem.readings, tracker)


def _seen(rows: Rows, residual: Float2D, problem: LoadedProblem, axes: Float3D, used: Int1D) -> Scatter:
    return scatter(rows.select(used), residual[used], problem.readings.select(used), axes[used])


def _rms(used: Int1D, prepared: PreparedLoaded) -> float:
    """Return the rms of the refitted null model over the readings used, m."""
    before = prepared.problem.linearise(prepared.fit.compliance)
    rest = without_offsets(before.rows.select(used), before.residual[used])
    return rms(rest)


def _left(attempt: Attempt) -> Scatter:
    """Take what the extended model leaves as the noise, where the steps are too few to see it."""
    _, ratio, _ = weighted_rest(attempt.extended)
    return claimed(max(1.0, attempt.seen.total * float(np.sqrt(ratio))))
