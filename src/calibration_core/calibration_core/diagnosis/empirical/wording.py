"""An empirical law in words: which joint, what it follows, where; and that it is no physics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.empirical.law import Law, LawTerm
from calibration_core.diagnosis.result.finding import EMPIRICAL, Alternative, Finding, FoundParameter
from calibration_core.identification.statistics.sizes import rms_length
from calibration_core.timeseries import Float2D, Int1D, Readings

EFFECT = "empirical_law"
WORST = 3  # configurations that are listed


def law_findings(law: Law, joints: Sequence[str], readings: Readings) -> tuple[Finding, ...]:
    """Return one finding for every joint of a law.

    Args:
        law: The law.
        joints: Their names.
        readings: The recording, of which the law holds a shift for every reading.
    """
    by_joint: dict[int, list[LawTerm]] = {}
    for term in law.terms:
        by_joint.setdefault(term.term.joint, []).append(term)
    return tuple(_finding(law, joints, number, terms, readings) for number, terms in by_joint.items())


def law_sentence(law: Law) -> str:
    """Return what the law does to the rest, in one sentence."""
    return (
        f"An empirical law, which is no physics and not in the extended model, describes {100 * law.explained:z.0f} % "
        "of it: see the findings."
    )


def _finding(law: Law, joints: Sequence[str], number: int, terms: list[LawTerm], readings: Readings) -> Finding:
    shift = np.sum([term.shift for term in terms], axis=0)
    magnitude = rms_length(shift)
    parameters = tuple(
        FoundParameter(name, float(value), float(std), "1")
        for term in terms
        for name, value, std in zip(term.term.names, term.coefficient, term.std, strict=True)
    )
    evidence = max(term.log_bayes_factor for term in terms)
    rivals = {other.joint: (other, score) for term in terms for other, score in term.rivals}
    alternatives = tuple(
        Alternative(EFFECT, EMPIRICAL, {"joint": joints[other.joint]}, score)
        for other, score in sorted(rivals.values(), key=lambda rival: -rival[1])
    )
    words = " and ".join(term.term.words for term in terms)
    parts = " + ".join(f"{p.value:z.3f} {p.name}" for p in parameters)
    listed = ", ".join(map(str, _largest(shift, readings.configuration)))
    text = (
        f"Empirical, not physics: how far {joints[number]} gives way follows {words}; beside the model it turns by "
        f"{parts}, in parts of its deflection at its largest torque (functions of angles: times torque over largest "
        f"torque). It moves the measured points by {1e6 * magnitude:.0f} µm rms, most in configurations {listed}. The "
        f"law describes {100 * law.explained:z.0f} % of what remains beyond the noise; on configurations left out, the "
        f"search repeated without them, it saves {100 * law.held_out_gain:z.0f} % of the squared error. It says where "
        "to look, not why, and stands in no model file."
    )
    return Finding(
        effect=EFFECT,
        family=EMPIRICAL,
        location={"joint": joints[number]},
        variant=words,
        parameters=parameters,
        log_bayes_factor=evidence,
        held_out_gain=law.held_out_gain,
        magnitude=magnitude,
        cannot_be_told_from=alternatives,
        explanation=text,
        separate_by=f"more configurations that differ in {words}, at the same torque of {joints[number]}",
    )


def _largest(shift: Float2D, configuration: Int1D) -> list[int]:
    """Return the numbers of the configurations that a shift (m, 3) moves most."""
    numbers = np.unique(configuration)
    squares = [float(np.mean(np.sum(shift[configuration == number] ** 2, axis=1))) for number in numbers]
    return [int(numbers[k]) for k in np.argsort(-np.array(squares), kind="stable")[:WORST]]
