"""What the model of several recordings of one robot leaves out: causes at the robot, and causes in one set-up."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from calibration_core.diagnosis.diagnose import diagnose, with_given_effects
from calibration_core.diagnosis.evidence.extended import loaded_state
from calibration_core.diagnosis.findings.loaded import registration
from calibration_core.diagnosis.loaded import FRAMES_SPOILED
from calibration_core.diagnosis.proposals.choose import Offer, Offers
from calibration_core.diagnosis.result.finding import Alternative, Diagnosis, Finding, Verdict, by_size
from calibration_core.identification.result.estimate import Anomaly, Disagreement
from calibration_core.identification.stiffness.loaded import PreparedLoaded
from calibration_core.model.effects.recordings import RECORDING
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.kinds import holds_both
from calibration_core.outcomes.together.agreement import (
    agreement,
    as_anomalies,
    by_themselves,
    effects_in,
    without_changes,
)
from calibration_core.outcomes.together.evaluate import (
    answered,
    estimate_of_first,
    factors_of,
    located_anomalies,
    of_first,
    widened,
    with_recording,
)
from calibration_core.outcomes.together.prepare import Prepared
from calibration_core.timeseries import Note, Readings

EFFECTS = "effects."
ROUNDS = 3  # of looking for what differs
BESIDE_FINDINGS: dict[Verdict, Verdict] = {
    "consistent": "missing_physics",
    "unexplained": "partly_explained",
    "missing_physics": "missing_physics",
    "partly_explained": "partly_explained",
}


def diagnose_together(prepared: Prepared, offers: Offers | None = None) -> Diagnosis:
    """Say what the model of all recordings together leaves out.

    A finding of the robot is shared by all of them; one of a set-up names its recording.

    Args:
        prepared: The recordings.
        offers: What could be measured next in the first recording's set-up; None: nothing is proposed.

    Raises:
        InputError: They cannot be evaluated together.
    """
    found, prepared, shown = _explained(prepared, offers)
    extended = found.model
    if prepared.given is not None:
        found = with_given_effects(found, prepared.given)
    excluded = found.identification.residuals.excluded
    identification = answered(found.identification, prepared, found.residual, excluded, extended, shown)
    together = identification.together
    assert together is not None  # noqa: S101 - of several recordings
    model, estimate = found.model, found.estimate
    if model is not None:
        model, estimate = _of_first(model, estimate, prepared)
    anomalies = located_anomalies(found.anomalies, prepared)
    set_up = f"To be measured in the set-up of {prepared.members[prepared.first].file}."
    registered, notes = _registered(prepared, anomalies)
    return dataclasses.replace(
        found,
        verdict=BESIDE_FINDINGS[found.verdict] if registered else found.verdict,
        identification=dataclasses.replace(identification, notes=(*identification.notes, *notes)),
        findings=by_size((*(_located(one, prepared) for one in found.findings), *registered)),
        anomalies=(*anomalies, *as_anomalies(together.disagreements)),
        next_text=" ".join(filter(None, (set_up if found.next_measurements else "", found.next_text))),
        model=model,
        estimate=estimate,
    )


def _explained(
    prepared: Prepared, offers: Offers | None
) -> tuple[Diagnosis, Prepared, tuple[GaussianEstimate, ...] | None]:
    """Diagnose the recordings as one, and where they differ once more less what differs; return the better answer.

    A joint that is softer in one recording is no physics that the model leaves out, but a sensor that couples its axes
    in that recording explains much of it; the other way round such a sensor makes joints of that recording differ.
    What predicts configurations that were left out better is taken.  What differs is looked for without effects first,
    and then beside those of the best answer so far.

    Returns:
        The answer; the recordings that it is of; and what each shows by itself beside its effects, None: not yet known.
    """
    files = [member.file for member in prepared.members]
    best = _diagnosed(prepared, offers), prepared
    seen: set[tuple[Disagreement, ...]] = set()
    beside: ModelParameters | None = None
    for _ in range(ROUNDS):
        shown = by_themselves(prepared, beside)
        changes = agreement(files, shown)[1]
        if changes and changes not in seen:
            best = min(best, _less(prepared, changes, offers), key=lambda answer: answer[0].held_out_after)
        seen.add(changes)
        found = best[0].model
        if found is beside or (beside is None and (found is None or not found.effects)):
            return *best, shown  # the same would differ again
        beside = found
    return *best, None


def _less(prepared: Prepared, changes: Sequence[Disagreement], offers: Offers | None) -> tuple[Diagnosis, Prepared]:
    """Diagnose the recordings less what differs; those that have changed do not tell what the others are like."""
    less = without_changes(prepared, changes)
    return widened(_diagnosed(less, offers), less.merged.cell, factors_of(less)), less


def _diagnosed(prepared: Prepared, offers: Offers | None) -> Diagnosis:
    merged = prepared.merged
    offered = None if offers is None else _beside_all(offers, prepared)
    return diagnose(merged.readings, merged.cell, prepared.options, prepared.test, offers=offered)


def _beside_all(offers: Offers, prepared: Prepared) -> Offers:
    """Return offers for the first recording's set-up, whose readings are expected as they would stand beside all."""

    def expected(several: Sequence[Offer], parameters: ModelParameters) -> Readings:
        return prepared.placed(offers.expected(several, of_first(parameters, prepared)))

    return Offers(offers.each, expected)


def _registered(prepared: Prepared, anomalies: Sequence[Anomaly]) -> tuple[list[Finding], list[Note]]:
    """Return trackers and points that stand elsewhere than their own cell file says, as each loaded recording shows it.

    Where a target or the tracker has moved, the recording does not show where they stood; nor does it beside postures
    at rest, which show errors of the geometry that would be taken for those of the frames.
    """
    findings: list[Finding] = []
    notes: list[Note] = []
    if holds_both(prepared.merged.readings, prepared.merged.cell):
        return findings, notes
    spoiled = {one.location.get(RECORDING) for one in anomalies if one.kind in FRAMES_SPOILED}
    for member, alone in zip(prepared.members, prepared.alone, strict=True):
        readings, cell, fit = member.readings, member.cell, alone.basis
        if member.file in spoiled or not isinstance(fit, PreparedLoaded):
            continue
        state = loaded_state(fit.problem, cell, fit.fit.compliance)
        found, noted = registration(fit, state, readings, sigma_points=cell.frames.sigma_points)
        where = {RECORDING: member.file}
        which = f"This is in recording {member.number}."
        findings += [
            dataclasses.replace(one, location={**one.location, **where}, explanation=f"{one.explanation} {which}")
            for one in found
        ]
        notes += [dataclasses.replace(one, place=f"{member.file}: {one.place}") for one in noted]
    return findings, notes


def _located(one: Finding, prepared: Prepared) -> Finding:
    others = tuple(_beside(other, prepared) for other in one.cannot_be_told_from)
    location = with_recording(one.location, prepared.members)
    return dataclasses.replace(one, location=location, cannot_be_told_from=others)


def _beside(one: Alternative, prepared: Prepared) -> Alternative:
    return dataclasses.replace(one, location=with_recording(one.location, prepared.members))


def _of_first(
    model: ModelParameters, estimate: GaussianEstimate, prepared: Prepared
) -> tuple[ModelParameters, GaussianEstimate]:
    """Return model and estimate with frames, points and effects of the first recording's set-up, and of the robot."""
    own = str(prepared.members[prepared.first].number)
    kept = [k for k, one in enumerate(model.effects) if one.location.get(RECORDING, own) == own]
    effects = effects_in(model.effects, prepared, prepared.first)
    rows, names = [], []
    for row, name in enumerate(estimate.names):
        number, _, parameter = name.removeprefix(EFFECTS).partition(".")
        if not name.startswith(EFFECTS):
            rows.append(row)
            names.append(name)
        elif int(number) in kept:
            rows.append(row)
            names.append(f"{EFFECTS}{kept.index(int(number))}.{parameter}")
    chosen = estimate.chosen(rows).renamed(names)
    return of_first(model.replace(effects=effects), prepared), estimate_of_first(chosen, prepared)
