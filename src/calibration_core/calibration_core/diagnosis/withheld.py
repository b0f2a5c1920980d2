"""Effects that are not named, although the recording asks for them: something that is no physics does clearly better.

Physics that the catalogue lacks looks like what in it comes nearest.  So an accepted effect must stand its ground
against every empirical law of the dictionary, in its own place in the model.
"""

from __future__ import annotations

import dataclasses

from calibration_core.diagnosis.empirical import EQUIVALENT, Rival, rival
from calibration_core.diagnosis.extended import Extended
from calibration_core.diagnosis.naming import said
from calibration_core.diagnosis.selection import Choice, Selection
from calibration_core.model.effects.candidate import Candidate
from calibration_core.timeseries import Readings


@dataclasses.dataclass(frozen=True, eq=False)
class Withheld:
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


def withheld(extended: Extended, selection: Selection) -> tuple[Withheld, ...]:
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
            found.append(Withheld(choice, extended.design.candidates[choice.candidate], law, nats))
    return tuple(found)


def withheld_sentence(one: Withheld, joints: tuple[str, ...], readings: Readings) -> str:
    """Say what was not named, and why.

    Args:
        one: The effect.
        joints: Names of the robot's joints.
        readings: The recording.
    """
    return (
        f"Not named, although it comes near: {said(one.candidate, readings)}. That {joints[one.rival.term.joint]} "
        f"follows {one.rival.term.words}, which is no physics of the catalogue, makes the recording more probable by a "
        f"factor of exp({one.nats:.0f})."
    )
