"""What the model of several recordings of one robot leaves out: causes at the robot, and causes in one set-up."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from calibration_core.diagnosis.diagnose import diagnose, with_given_effects
from calibration_core.diagnosis.evidence.extended import loaded_state
from calibration_core.diagnosis.findings.registration import registration_findings
from calibration_core.diagnosis.loaded import FRAMES_SPOILED
from calibration_core.diagnosis.proposals.candidates import Offer, Offers
from calibration_core.diagnosis.result.finding import Alternative, Diagnosis, Finding, Location, Verdict, by_size
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded
from calibration_core.model.effects.recordings import RECORDING
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.kinds import holds_both, is_loaded
from calibration_core.outcomes.together.agreement import as_anomalies
from calibration_core.outcomes.together.evaluate import (
    answered,
    estimate_of_first,
    located_anomalies,
    of_first,
    with_recording,
)
from calibration_core.outcomes.together.prepare import Prepared
from calibration_core.timeseries import Readings

EFFECTS = "effects."
SET_UP = {RECORDING, "point"}  # what the place of an effect names that does not belong to the robot
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
    merged = prepared.merged
    offered = None if offers is None else _beside_all(offers, prepared)
    found = diagnose(merged.readings, merged.cell, prepared.options, prepared.test, offers=offered)
    shared = [] if found.model is None else [one for one in found.model.effects if not SET_UP & set(one.location)]
    if prepared.given is not None:
        found = with_given_effects(found, prepared.given)
    excluded = found.identification.residuals.excluded
    identification = answered(found.identification, prepared, found.residual, excluded, shared)
    together = identification.together
    assert together is not None  # noqa: S101 - of several recordings
    model, estimate = found.model, found.estimate
    if model is not None:
        model, estimate = _of_first(model, estimate, prepared)
    anomalies = located_anomalies(found.anomalies, prepared)
    set_up = f"To be measured in the set-up of {prepared.members[prepared.first].file}."
    registered = _registered(prepared, anomalies)
    return dataclasses.replace(
        found,
        verdict=BESIDE_FINDINGS[found.verdict] if registered else found.verdict,
        identification=identification,
        findings=by_size((*(_located(one, prepared) for one in found.findings), *registered)),
        anomalies=(*anomalies, *as_anomalies(together.disagreements)),
        next_text=" ".join(filter(None, (set_up if found.next_measurements else "", found.next_text))),
        model=model,
        estimate=estimate,
    )


def _beside_all(offers: Offers, prepared: Prepared) -> Offers:
    """Return offers for the first recording's set-up, whose readings are expected as they would stand beside all."""

    def expected(several: Sequence[Offer], parameters: ModelParameters) -> Readings:
        return prepared.placed(offers.expected(several, of_first(parameters, prepared)))

    return Offers(offers.each, expected)


def _registered(prepared: Prepared, anomalies: Sequence[Anomaly]) -> list[Finding]:
    """Return trackers and points that stand elsewhere than their own cell file says, as each loaded recording shows it.

    Where a target or the tracker has moved, the recording does not show where they stood; nor does it beside postures
    at rest, which show errors of the geometry that would be taken for those of the frames.
    """
    if holds_both(prepared.merged.readings, prepared.merged.cell):
        return []
    spoiled = {one.location.get(RECORDING) for one in anomalies if one.kind in FRAMES_SPOILED}
    found = []
    for member, start in zip(prepared.members, prepared.starts, strict=True):
        readings, cell = member.readings, member.cell
        if member.file in spoiled or not is_loaded(readings):
            continue
        alone = prepare_loaded(readings, cell, Options(robust=prepared.options.robust, start=start))
        state = loaded_state(alone.problem, cell, alone.fit.compliance)
        found += [
            dataclasses.replace(
                one,
                location={**one.location, RECORDING: member.file},
                explanation=f"{one.explanation} This is in recording {member.number}.",
            )
            for one in registration_findings(alone, state, readings)
        ]
    return found


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
    effects = tuple(
        dataclasses.replace(one, location=_location_of_first(one.location, prepared))
        for one in (model.effects[k] for k in kept)
    )
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


def _location_of_first(location: Location, prepared: Prepared) -> Location:
    """Return the place of an effect as the first recording has it by itself; points are counted among its own."""
    member = prepared.members[prepared.first]
    found = {key: value for key, value in location.items() if key != RECORDING}
    point = str(location.get("point", ""))
    if point.startswith("#"):
        name = prepared.merged.readings.points[int(point[1:])]
        found["point"] = f"#{[member.point(own) for own in member.readings.points].index(name)}"
    return found
