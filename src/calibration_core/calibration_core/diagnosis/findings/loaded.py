"""From accepted candidates to findings in words.

Frames and points that the absolute positions put elsewhere than the cell file, or a given model, does.

They are refitted before anything else, so they spoil no other finding; but the simulation has them wrong.  A cell that
is set up with care is right to a few tenths of a millimetre and of a milliradian; what is beyond is said.  A tracker
that stands elsewhere turns the measured deflections, and is a finding where they show it; what they do not show, and
where targets are, is a note for the cell file.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.empirical import Rival, rival
from calibration_core.diagnosis.evidence.design import Choice, LoadedSelection
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.result.finding import (
    FRAMES,
    UNSETTLED,
    Alternative,
    Finding,
    Location,
    by_size,
    confounded_with,
    evidence_words,
    found_parameters,
    opening,
    separating,
)
from calibration_core.estimation.hypotheses import LAW
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.result.observability import TWO_SIDED
from calibration_core.identification.statistics import rms_length
from calibration_core.identification.stiffness.loaded import PreparedLoaded
from calibration_core.model.chain import rotation_vector, xyz_rpy
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.candidate import Candidate, typical
from calibration_core.model.effects.state import State
from calibration_core.model.effects.words import listed_location
from calibration_core.observations.average import coordinate_std
from calibration_core.policy import EQUIVALENT, LISTED
from calibration_core.timeseries import Float1D, Float2D, Note, Readings

SEEN = 0.02  # relative change of a stiffness that is stated
DETERMINED = 2.0  # standard deviations from zero, at which a compliance counts as known


def findings_of(
    extended: ExtendedLoadedModel, selection: LoadedSelection, identification: Identification, readings: Readings
) -> tuple[Finding, ...]:
    """Return the findings, largest effect on the measured points first."""
    design = extended.design
    changes = _stiffness_changes(extended, identification)
    found = []
    for choice in selection.choices:
        candidate = design.candidates[choice.candidate]
        magnitude = rms_length(extended.moved((choice.candidate, *choice.refinements)))
        alternatives = tuple(_alternative(design.candidates[i], score, readings) for i, score in choice.equivalents)
        location = _location(candidate.location, readings)
        open_place = len(alternatives) > LISTED
        settled = candidate.family != LAW or not choice.refinements
        found.append(
            Finding(
                effect=candidate.effect,
                family=candidate.family,
                location={} if open_place else location,
                variant=candidate.variant,
                parameters=found_parameters(candidate, *extended.values_of(choice.candidate)),
                log_bayes_factor=choice.log_bayes_factor,
                held_out_gain=choice.held_out_gain,
                magnitude=magnitude,
                explanation=_explanation(
                    candidate,
                    location,
                    choice,
                    magnitude,
                    _bias(changes, len(selection.choices)),
                    alternatives[:LISTED],
                )
                + ("" if settled else UNSETTLED),
                separate_by=separating([candidate.effect, *(a.effect for a in alternatives)]),
                cannot_be_told_from=alternatives[:LISTED],
                stiffness_change=changes,
                refinements=tuple(describe(design.candidates[i], readings) for i in choice.refinements),
                law_settled=settled,
            )
        )
    return by_size(found)


def _alternative(candidate: Candidate, score: float, readings: Readings) -> Alternative:
    return Alternative(candidate.effect, candidate.family, _location(candidate.location, readings), score)


def _location(location: Location, readings: Readings) -> Location:
    """Replace the index of a point by its name."""
    return {
        key: readings.points[int(value[1:])]
        if key == "point" and isinstance(value, str) and value[:1] == "#"
        else value
        for key, value in location.items()
    }


def _stiffness_changes(extended: ExtendedLoadedModel, identification: Identification) -> dict[str, float]:
    """Return joint -> relative change, of those joints whose stiffness the recording determines with the effects."""
    changes = {}
    values = zip(identification.stiffness, extended.compliance, extended.compliance_std, strict=True)
    for joint, compliance, std in values:
        if joint.compliance > 0 and compliance > DETERMINED * std:
            changes[joint.joint] = float(joint.compliance / compliance - 1)
    return changes


def describe(candidate: Candidate, readings: Readings) -> str:
    """Return a candidate in words: effect, place and variant."""
    place = listed_location(_location(candidate.location, readings))
    return f"{candidate.effect} ({place}; {candidate.variant})"


def _explanation(
    candidate: Candidate,
    location: Location,
    choice: Choice,
    magnitude: float,
    bias: str,
    alternatives: tuple[Alternative, ...],
) -> str:
    text = (
        f"{opening(candidate.effect, location)}. This moves the measured points by {1e6 * magnitude:.0f} µm rms; "
        f"{evidence_words(choice.log_bayes_factor)}."
    )
    return text + bias + confounded_with(alternatives)


def _bias(changes: dict[str, float], findings: int) -> str:
    """Say which stiffnesses of the standard's model are biased by all findings together; empty where none is.

    `changes` go from the standard's model to the extended one; a bias goes the other way, relative to what is right.
    """
    biases = {joint: 1.0 / (1.0 + change) - 1.0 for joint, change in changes.items()}
    moved = {joint: bias for joint, bias in biases.items() if abs(bias) > SEEN}
    if not moved:
        return ""
    listed = ", ".join(f"{joint} {100 * bias:+z.0f} %" for joint, bias in moved.items())
    which = "it" if findings == 1 else "all findings"
    return f" Leaving {which} out biases the stiffness of {listed}."


@dataclasses.dataclass(frozen=True, eq=False)
class RejectedCandidate:
    """An effect that was accepted and is outdone."""

    choice: Choice
    candidate: Candidate
    rival: Rival
    nats: float


def rejected_candidates(extended: ExtendedLoadedModel, selection: LoadedSelection) -> tuple[RejectedCandidate, ...]:
    """Return the choices that a law of the dictionary outdoes by more than what counts as equivalent.

    The effect's evidence is the larger of that by which it was accepted, with the prior of its physics, and that by
    the measure of the law, which knows no prior.
    """
    found = []
    for choice in selection.choices:
        law = rival(extended, (choice.candidate, *choice.refinements))
        if law is None:
            continue
        nats = law.log_bayes_factor - max(law.own, choice.log_bayes_factor)
        if nats > EQUIVALENT:
            found.append(RejectedCandidate(choice, extended.design.candidates[choice.candidate], law, nats))
    return tuple(found)


def rejection_sentence(one: RejectedCandidate, joints: tuple[str, ...], readings: Readings) -> str:
    """Say what was not named, and why."""
    return (
        f"Not named, although it comes near: {describe(one.candidate, readings)}. The recording says more that "
        f"{joints[one.rival.term.joint]} follows {one.rival.term.words}, which is no physics of the catalogue: "
        f"{evidence_words(one.nats)}."
    )


# --- frames and points that the absolute positions put elsewhere than the cell file, or a given model, ----------------


TRACKER, TARGETS = "frames.tracker", "frames.measurement_points"  # places of notes
BEYOND = 4.5  # times how well cells are set up, their uncertainty included

Registered = tuple[tuple[Finding, ...], tuple[Note, ...]]


def registration(
    prepared: PreparedLoaded,
    state: State,
    readings: Readings,
    beside: FrameFit | None = None,
    sigma_points: float | None = None,
) -> Registered:
    """Return a tracker that stands elsewhere than stated as a finding, or as a note, and targets as a note.

    What was found in the robot moves points under its own weight, too: what only seems elsewhere because of it is none.

    Args:
        prepared: With the refitted frames, and where cell file or given model put them.
        state: The null model, for the size of the effect on the measured deflections.
        readings: The recording.
        beside: The frames as they fit best beside what was found; None: nothing was.
        sigma_points: What the cell file states of its targets, m; None: nothing.
    """
    frames = prepared.frames
    if frames is None or prepared.stated_by is None or frames.freedom < 1:
        return (), ()
    findings: list[Finding] = []
    notes: list[Note] = []
    every = [frames] if beside is None else [frames, beside]
    if all(_turned(one, prepared, state) for one in every):
        found = _tracker(every[-1], prepared, state)
        seen = found.magnitude > np.sqrt(3.0) * coordinate_std(prepared.problem.noise)
        note = Note(FRAMES, TRACKER, f"{found.explanation} For the cell file: {_pose(every[-1].tracker)}")
        findings, notes = ([found], []) if seen else ([], [note])
    odd = [_odd_point(one, prepared, readings) for one in every]
    usual = sigma_points or typical("registration_point", state.rated_load)
    if len({point for point, _, _ in odd}) == 1 and all(_beyond(*one[1:], usual) for one in odd):
        notes.append(_points(every[-1], *odd[-1], prepared, readings))
    return tuple(findings), tuple(notes)


def _turn(frames: FrameFit, prepared: PreparedLoaded) -> tuple[Float1D, Float2D]:
    turn = rotation_vector(frames.tracker[:3, :3] @ prepared.nominal.tracker[:3, :3].T)
    return turn, frames.covariance[3:6, 3:6]


def _turned(frames: FrameFit, prepared: PreparedLoaded, state: State) -> bool:
    return _beyond(*_turn(frames, prepared), typical("registration_rotation", state.rated_load))


def _odd_point(frames: FrameFit, prepared: PreparedLoaded, readings: Readings) -> tuple[int, Float1D, Float2D]:
    """Return the point that is farthest from where it is stated, against the others, its shift (3,) m and covariance.

    A shift of all is the flange's or the geometry's.
    """
    stated = np.array([prepared.nominal.points[name] for name in readings.points])
    shift = frames.points - stated
    if len(shift) > 1:
        shift = shift - (shift.sum(axis=0) - shift) / (len(shift) - 1)
    point = int(np.argmax(np.linalg.norm(shift, axis=1)))
    rows = slice(6 + 3 * point, 9 + 3 * point)
    return point, shift[point], frames.covariance[rows, rows]


def _beyond(value: Float1D, covariance: Float2D, usual: float) -> bool:
    """Return whether (3,) values lie beyond usual care and their uncertainty, as a distance of Mahalanobis."""
    return bool(value @ np.linalg.solve(covariance + usual**2 * np.eye(3), value) > BEYOND**2)


def _points(
    frames: FrameFit, point: int, shift: Float1D, covariance: Float2D, prepared: PreparedLoaded, readings: Readings
) -> Note:
    away, half = 1e3 * float(np.linalg.norm(shift)), 1e3 * TWO_SIDED * float(np.sqrt(np.trace(covariance) / 3))
    fitted = zip(readings.points, frames.points, strict=True)
    lines = ", ".join(f"{name}: [{', '.join(f'{x:.5f}' for x in at)}]" for name, at in fitted)
    text = (
        f"{readings.points[point]} is {away:.2f} mm (± {half:.2f} mm) from where {prepared.stated_by} puts it, against "
        f"the others. All were refitted, and nothing else rests on it. For the cell file, in the flange frame: {lines}"
    )
    return Note(FRAMES, TARGETS, text)


def _tracker(frames: FrameFit, prepared: PreparedLoaded, state: State) -> Finding:
    (turn, covariance), usual = _turn(frames, prepared), typical("registration_rotation", state.rated_load)
    kind = effect_named("tracker_frame_misalignment")
    candidate = next(iter(kind.candidates(state)))
    size = rms_length(state.since_step_zero(candidate.columns(state) @ turn))
    return Finding(
        effect=kind.name,
        family="point chain",
        location={"tracker": "tracker"},
        variant=candidate.variant,
        parameters=found_parameters(candidate, turn, covariance),
        log_bayes_factor=0.5 * float(turn @ np.linalg.solve(covariance + usual**2 * np.eye(3), turn)),
        held_out_gain=0.0,
        magnitude=size,
        explanation=(
            f"The tracker frame is turned by {1e3 * float(np.linalg.norm(turn)):.2f} mrad against "
            f"{prepared.stated_by}, as the absolute positions say. It was refitted before anything else; with the "
            f"stated value the deflections would be wrong by {1e6 * size:.0f} µm rms, the positions by more."
        ),
        separate_by=kind.reveal,
    )


def _pose(tracker: Float2D) -> str:
    numbers = [f"{x:.5f}" for x in xyz_rpy(tracker)]
    return f"tracker: {{xyz: [{', '.join(numbers[:3])}], rpy: [{', '.join(numbers[3:])}]}}"
