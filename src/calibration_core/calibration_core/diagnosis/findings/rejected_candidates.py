"""Effects that are not named, although the recording asks for them: something that is no physics does clearly better.

Physics that the catalogue lacks looks like what in it comes nearest.  So an accepted effect must stand its ground
against every empirical law of the dictionary, in its own place in the model.
"""

from __future__ import annotations

import dataclasses

from calibration_core.diagnosis.empirical.law import EQUIVALENT, Rival, rival
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.evidence.selection import Choice, LoadedSelection
from calibration_core.diagnosis.findings.loaded import describe
from calibration_core.diagnosis.result.evidence_words import evidence_words
from calibration_core.model.effects.candidate import Candidate
from calibration_core.timeseries import Readings


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

    Args:
        extended: The extended model with all choices.
        selection: The choices.
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
    """Say what was not named, and why.

    Args:
        one: The effect.
        joints: Names of the robot's joints.
        readings: The recording.
    """
    return (
        f"Not named, although it comes near: {describe(one.candidate, readings)}. The recording says more that "
        f"{joints[one.rival.term.joint]} follows {one.rival.term.words}, which is no physics of the catalogue: "
        f"{evidence_words(one.nats)}."
    )
