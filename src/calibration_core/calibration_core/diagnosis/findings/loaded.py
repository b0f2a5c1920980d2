"""From accepted candidates to findings in words."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from calibration_core.diagnosis.empirical.law import EQUIVALENT, Rival, rival
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.evidence.selection import Choice, LoadedSelection
from calibration_core.diagnosis.findings.building import confounded_with, found_parameters, opening, separating
from calibration_core.diagnosis.result.finding import UNSETTLED, Alternative, Finding, Location, by_size, evidence_words
from calibration_core.estimation.hypotheses import LAW
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.statistics.sizes import rms_length
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.words import listed_location
from calibration_core.timeseries import Readings

if TYPE_CHECKING:
    from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel

LISTED = 5
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
                held_out_gain=_gain(extended, selection, choice),
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


def _gain(extended: ExtendedLoadedModel, selection: LoadedSelection, choice: Choice) -> float:
    from calibration_core.diagnosis.evidence.residual import held_out_error

    mine = {choice.candidate, *choice.refinements}
    others = tuple(index for index in selection.accepted if index not in mine)
    without, whole = (held_out_error(extended.design, accepted) for accepted in (others, selection.accepted))
    return float(1 - (whole / without) ** 2)


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
    """An effect that was accepted and is outdone.

    Attributes:
        choice: What was accepted.
        candidate: The effect.
        rival: What outdoes it.
        nats: By how much.
    """

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
