"""Several recordings identified as one, and what is said of the whole.

Intervals of what some recordings show otherwise: they do not tell what the robot of the others is like.

What differs is taken off the readings as it was found beside the others, so that a recording that has changed agrees
with them about that parameter, and would count as if it had shown it.  Its share of what is known is taken away again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration_core.acceptance.comparison import COMPLIANCE
from calibration_core.cell import Cell
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.geometry.parameter_table import model_paths
from calibration_core.identification.identify import fit_freed, with_given
from calibration_core.identification.result.estimate import (
    MODEL_FREE,
    Anomaly,
    Contribution,
    Disagreement,
    Identification,
    JointStiffness,
    ParameterEstimate,
    Precondition,
    Together,
)
from calibration_core.identification.result.observability import joint_stiffness
from calibration_core.identification.several.merge import Member, noise_factor, numbered
from calibration_core.identification.several.mixed import SET_UP, estimate_of_set_up, of_set_up
from calibration_core.model.chain import xyz_rpy
from calibration_core.model.identified.calibrated import ValidRange, range_of
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.parameters import ModelParameters
from calibration_core.outcomes.together.agreement import agreement, as_anomalies, by_themselves, without_changes
from calibration_core.outcomes.together.prepare import Prepared
from calibration_core.timeseries import Bool1D, Float1D, Float2D


def factors_of(less: Prepared) -> dict[str, float]:
    """Return parameter -> factor on its standard deviation, at least 1, of recordings that are free of what differs."""
    files = [member.file for member in less.members]
    estimates = by_themselves(less.measured)
    found = {}
    for parameter in {one.parameter for one in less.changes}:
        changed = {one.file for one in less.changes if one.parameter == parameter}
        known = {file: _information(one, parameter) for file, one in zip(files, estimates, strict=True)}
        rest = sum(value for file, value in known.items() if file not in changed)
        found[parameter] = float(np.sqrt(sum(known.values()) / rest)) if rest > 0 else np.inf
    return found


def widened(found: Diagnosis, cell: Cell, wider: Mapping[str, float]) -> Diagnosis:
    """Return a diagnosis whose standard deviations are larger by factors, parameter by parameter."""
    by_joint = np.array([wider.get(f"{COMPLIANCE}{joint}", 1.0) for joint in cell.robot.joints])
    covariance = found.compliance_covariance
    return dataclasses.replace(
        found,
        identification=widened_identification(found.identification, cell, wider),
        stiffness={
            joint: (value, std * wider.get(f"{COMPLIANCE}{joint}", 1.0))
            for joint, (value, std) in found.stiffness.items()
        },
        compliance_covariance=None if covariance is None else _scaled(covariance, by_joint),
        estimate=found.estimate.scaled(wider),
    )


def widened_identification(found: Identification, cell: Cell, wider: Mapping[str, float]) -> Identification:
    """Return an identification whose standard deviations are larger by factors, parameter by parameter."""
    paths = model_paths(cell)
    own = {name: wider.get(path, 1.0) for name, path in paths.items()}
    return dataclasses.replace(
        found,
        stiffness=tuple(_joint(one, wider.get(f"{COMPLIANCE}{one.joint}", 1.0)) for one in found.stiffness),
        parameters=tuple(dataclasses.replace(one, std=one.std * own.get(one.name, 1.0)) for one in found.parameters),
        covariance=_scaled(found.covariance, np.array([own.get(name, 1.0) for name in found.names])),
        estimate=found.estimate.scaled(wider),
    )


def _joint(one: JointStiffness, factor: float) -> JointStiffness:
    if factor == 1.0:
        return one
    wide = joint_stiffness(
        one.joint,
        one.compliance,
        factor * one.compliance_std,
        identifiable=one.identifiable,
        reason=one.reason,
        unit=one.unit,
    )
    return dataclasses.replace(wide, extended=None if one.extended is None else _joint(one.extended, factor))


def _scaled(covariance: Float2D, factor: Float1D) -> Float2D:
    return covariance * np.outer(factor, factor)


def _information(estimate: GaussianEstimate, parameter: str) -> float:
    """Return what an estimate knows of a parameter, one over its variance; 0 where it has none."""
    if parameter not in estimate.names:
        return 0.0
    row = estimate.names.index(parameter)
    return float(1.0 / estimate.covariance[row, row])


# --- several recordings identified as one, and what is said of the whole ----------------------------------------------


UNDERSTATED = "noise_understated"


def identify_together(prepared: Prepared) -> Identification:
    """Identify from all recordings together.

    Raises:
        InputError: They cannot be evaluated together.
    """
    merged = prepared.merged
    found = fit_freed(merged.readings, merged.cell, prepared.options, prepared.test)
    if prepared.given is not None:
        found = with_given(found, prepared.given)
    return answered(found, prepared, found.residuals.residual, found.residuals.excluded)


def identify_less(prepared: Prepared, changes: Sequence[Disagreement]) -> Identification:
    """Identify from all recordings together, less what differs between them.

    Recordings that have changed do not tell what the robot of the others is like, and intervals say so.

    Raises:
        InputError: A recording cannot be evaluated by itself without its change.
    """
    less = without_changes(prepared, changes)
    return widened_identification(identify_together(less), less.merged.cell, factors_of(less))


def answered(
    found: Identification,
    prepared: Prepared,
    residual: Float2D,
    excluded: Bool1D,
    model: ModelParameters | None = None,
    shown: Sequence[GaussianEstimate] | None = None,
) -> Identification:
    """Return the answer as it is handed out: model and frames of the first recording, and what each contributes.

    Args:
        found: Of all recordings together.
        prepared: The recordings.
        residual: (m, 3) m, what the common model leaves of every reading.
        excluded: (m,) readings that were not used.
        model: Of all together with the effects that were found: these are no reason for recordings to differ.
        shown: What each recording shows by itself beside these effects; None: it is evaluated.
    """
    if shown is None:
        shown = by_themselves(prepared.measured, model)
    together = _together(found, prepared, residual, excluded, shown)
    own = [one for one in found.parameters if one.group not in SET_UP]
    parameters = [
        dataclasses.replace(one, name=_beside(one, prepared.members[k]))
        for k in prepared.named
        for one in prepared.alone[k].parameters
        if one.group in SET_UP
    ]
    return dataclasses.replace(
        found,
        parameters=(*parameters, *own),
        anomalies=(*located_anomalies(found.anomalies, prepared), *as_anomalies(together.disagreements)),
        preconditions=_preconditions(found, prepared),
        model=of_first(found.model, prepared),
        estimate=estimate_of_first(found.estimate, prepared),
        together=together,
    )


def of_first(model: ModelParameters, prepared: Prepared) -> ModelParameters:
    """Return a model of all recordings with tracker pose and points of the first one, as its cell file names them."""
    return of_set_up(model, prepared.members[prepared.first], prepared.alone[prepared.first])


def estimate_of_first(estimate: GaussianEstimate, prepared: Prepared) -> GaussianEstimate:
    """Return what is known of the numbers of `of_first`."""
    return estimate_of_set_up(estimate, prepared.members[prepared.first], prepared.alone[prepared.first])


def covered(prepared: Prepared, model: ModelParameters) -> ValidRange:
    """Return what all recordings together cover; temperatures as each thermometer showed them."""
    whole = range_of(prepared.merged.readings, prepared.merged.cell, model)
    known = np.concatenate([member.readings.temperature for member in prepared.members])
    known = known[np.isfinite(known)]
    temperature = (float(known.min()), float(known.max())) if len(known) else None
    return dataclasses.replace(whole, temperature=temperature)


def located_anomalies(anomalies: Sequence[Anomaly], prepared: Prepared) -> tuple[Anomaly, ...]:
    """Return the anomalies, each with its recording where it is in one alone, and noise that one's claim understates.

    The claims that stand beside each other are right already, so that the whole shows no such noise any more.
    """
    members = prepared.members
    located = [dataclasses.replace(one, location=_location(one, members)) for one in anomalies]
    if any(one.kind == UNDERSTATED for one in anomalies):
        return tuple(located)
    noise = [
        dataclasses.replace(one, location={**one.location, "recording": member.file}, text=f"{member.file}: {one.text}")
        for member, alone in zip(members, prepared.alone, strict=True)
        for one in alone.anomalies
        if one.kind == UNDERSTATED and any(check.source in MODEL_FREE for check in alone.noise.checks)
    ]
    return (*noise, *located)


def _location(one: Anomaly, members: Sequence[Member]) -> dict[str, Any]:
    """Return where an anomaly is, with its recording where all its configurations are of one."""
    found = with_recording(one.location, members)
    if one.configurations is not None and "recording" not in found:
        holding = next((member for member in members if _within(one.configurations, numbered(member))), None)
        if holding is not None:
            found["recording"] = holding.file
    return found


def _within(some: tuple[int, int], all_: tuple[int, int]) -> bool:
    return all_[0] <= min(some) and max(some) <= all_[1]


def with_recording(location: Mapping[str, Any], members: Sequence[Member]) -> dict[str, Any]:
    """Return a location with the file of its recording, and a point as that recording calls it."""
    found = dict(location)
    name, mark, number = str(location.get("point", "")).rpartition("@")
    if mark:
        found |= {"point": name, "recording": number}
    if str(found.get("recording", "")).isdecimal():
        found["recording"] = members[int(str(found["recording"])) - 1].file
    return found


def _beside(one: ParameterEstimate, member: Member) -> str:
    """Return the name of a frame's parameter beside those of other recordings, e.g. `tracker@2 x`."""
    what, _, axis = one.name.rpartition(" ")
    return f"{member.point(what)} {axis}"


def _together(
    found: Identification,
    prepared: Prepared,
    residual: Float2D,
    excluded: Bool1D,
    shown: Sequence[GaussianEstimate],
) -> Together:
    files = [member.file for member in prepared.members]
    compared, differing = agreement(files, shown)
    each = []
    for k in prepared.named:
        rows = prepared.merged.readings.recording == prepared.members[k].number - 1
        each.append(_contribution(found, prepared, k, residual[rows], excluded[rows]))
    return Together(tuple(each), compared, differing, prepared.changes)


def _contribution(
    found: Identification, prepared: Prepared, k: int, residual: Float2D, excluded: Bool1D
) -> Contribution:
    """Return what one recording contributes; residual (m, 3) m and readings not used, (m,), of that one."""
    member, alone = prepared.members[k], prepared.measured.alone[k]
    readings, left = member.readings, residual[~excluded]
    displacement = member.cell.measurements.points == "displacement"
    steps = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    return Contribution(
        file=member.file,
        number=member.number,
        cell=str(member.cell.path),
        cell_sha256=member.cell.sha256,
        kind=alone.kind,
        configurations=len(np.unique(readings.configuration)),
        numbers=numbered(member),
        first_number=member.first_number,
        steps=len(steps),
        readings=len(readings),
        excluded=int(excluded.sum()),
        points=readings.points,
        noise=alone.noise.claimed,
        scale=noise_factor(alone),
        rms=float(np.sqrt(np.mean(left**2))) if len(left) else 0.0,
        tracker=None if displacement else _pose(found, prepared, k),
        stiffness={one.joint: (one.value, one.std) for one in alone.stiffness if one.identifiable},
        sha256=readings.provenance.sha256,
    )


def _pose(found: Identification, prepared: Prepared, k: int) -> tuple[float, ...]:
    pose: Float2D = prepared.alone[k].model.tracker
    if found.model.setups is not None:
        pose = found.model.tracker @ found.model.setups[k] @ pose
    return tuple(float(x) for x in xyz_rpy(pose))


def _preconditions(found: Identification, prepared: Prepared) -> tuple[Precondition, ...]:
    """Return the standard's demands on every recording by itself; on the number of configurations, of all together.

    Beside loaded recordings those at rest are for frames and geometry, and nothing is demanded of them.
    """
    merged: dict[tuple[str, str], list[tuple[Member, Precondition]]] = {}
    for k in (k for k in prepared.named if prepared.alone[k].kind == found.kind):
        for one in prepared.alone[k].preconditions:
            merged.setdefault((one.clause, one.requirement), []).append((prepared.members[k], one))
    whole = {(one.clause, one.requirement): one for one in found.preconditions}
    rows = []
    for key, several in merged.items():
        texts = list(dict.fromkeys(one.found for _, one in several))
        order = [met for met in (False, None, True) if any(one.met is met for _, one in several)]
        text = texts[0] if len(texts) == 1 else "; ".join(f"{member.file}: {one.found}" for member, one in several)
        worst = next(one for _, one in several if one.met is order[0])
        counted = key in whole and "manipulator configurations" in key[1]
        rows.append(whole[key] if counted else dataclasses.replace(worst, found=text, met=order[0]))
    return tuple(rows)
