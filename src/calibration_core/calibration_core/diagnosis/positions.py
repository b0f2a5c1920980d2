"""Diagnosis from positions, at rest and under load in one: what the model leaves out, found, named and proven."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.data_checks.adequacy import shift_anomalies, what_remains
from calibration_core.diagnosis.data_checks.loaded_anomalies import (
    Checked,
    check_each,
    noise_understated,
    outlier_readings,
)
from calibration_core.diagnosis.data_checks.noise import Scatter
from calibration_core.diagnosis.empirical import with_open_joints
from calibration_core.diagnosis.evidence.extended import aliases, loaded_state
from calibration_core.diagnosis.findings.geometry import geometry_findings
from calibration_core.diagnosis.findings.positions import position_findings
from calibration_core.diagnosis.model_estimate import positions_compliance, positions_estimate
from calibration_core.diagnosis.proposals.choose import NONE_ASKED, Offers, Proposals
from calibration_core.diagnosis.proposals.postures import Known, propose_loads, propose_postures
from calibration_core.diagnosis.result.finding import Diagnosis, Finding, Rest, by_size
from calibration_core.estimation.alternatives import equivalents, with_unnamed
from calibration_core.estimation.blocks import posture_blocks, time_blocks
from calibration_core.estimation.estimate import Estimate, estimate
from calibration_core.estimation.hypotheses import is_axial
from calibration_core.estimation.refit import Extended
from calibration_core.estimation.shifts import FAMILY
from calibration_core.identification.absolute.evaluate import Evaluated, evaluate_absolute, identification_of
from calibration_core.identification.checks.noise_audit import rigid_triangle
from calibration_core.identification.identify import fit_freed
from calibration_core.identification.result.estimate import Anomaly, Identification
from calibration_core.identification.several.mixed import BothFits, fit_both
from calibration_core.identification.statistics import rms, rms_length
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.tested import tested_on
from calibration_core.model.effects.applied import applied
from calibration_core.model.parameters import AppliedEffect
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.timeseries import Float2D, Readings

DWARFS = 10.0  # times what remains unexplained, that a geometry error beside it must move the points
REPORTED = {"time": 10, "posture": 20}  # blocks left out in the figures that are reported


def diagnose_still(
    readings: Readings,
    cell: Cell,
    options: Options | None = None,
    test: Readings | None = None,
    offers: Offers | None = None,
    identified: Identification | None = None,
) -> Diagnosis:
    """Say what the model of a recording at rest leaves out; arguments as `diagnose`.

    Rows are in the order of time.

    Raises:
        InputError: As `identify_absolute`.
    """
    options = options or Options()
    if identified is not None and isinstance(identified.basis, Evaluated):
        evaluated = identified.basis
    else:
        evaluated, identified = evaluate_absolute(readings, cell, options), None
    found = estimate(readings, cell, evaluated)
    readmitted = frozenset(
        (int(readings.configuration[k]), int(readings.step[k]), readings.points[readings.point[k]])
        for k in np.flatnonzero(found.extended.model.used & ~evaluated.used)
    )
    if readmitted:  # gross errors only under the null model
        options, identified = dataclasses.replace(options, readmit=options.readmit | readmitted), None
        evaluated = evaluate_absolute(readings, cell, options)
    if found.parts(anomalies=True):  # what identification says is said of readings freed of what moved
        freed = _freed(found, readings)
        evaluated = evaluate_absolute(freed, cell, options)
        identification = identification_of(evaluated, freed, cell, test=test)
    else:
        identification = identified or identification_of(evaluated, readings, cell, test=test)
    return diagnosis_of(found, evaluated, identification, cell, test=test, offers=offers)


def _moved(found: Estimate) -> Float2D:
    """Return by how much tracker and targets that moved have moved readings, (m, 3) m, tracker axes."""
    return found.extended.shift(found.parts(anomalies=True)) @ found.extended.parameters.tracker[:3, :3]


def _freed(found: Estimate, readings: Readings) -> Readings:
    return dataclasses.replace(readings, position=readings.position - _moved(found))


def diagnosis_of(
    found: Estimate,
    evaluated: Evaluated,
    identification: Identification,
    cell: Cell,
    *,
    test: Readings | None = None,
    offers: Offers | None = None,
    anomalies: tuple[Anomaly, ...] = (),
) -> Diagnosis:
    """Say in values and words what an estimate holds.

    Args:
        found: The estimate.
        evaluated: Frames and geometry of the null model.
        identification: What `identify` says of the recording.
        cell: The cell file.
        test: A second recording, predicted but not fitted.
        offers: What could be measured next; None: nothing is proposed.
        anomalies: Found in the data before.
    """
    as_found = found  # decisions were made without what small effects leave open
    if found.extended.model.problem.load is not None:
        found = dataclasses.replace(found, extended=with_unnamed(found.extended, found.search, found.selection))
    readings, null = found.extended.model.readings, found.null
    noise = coordinate_std(position_covariance(readings, cell))
    findings = position_findings(found)
    found = dataclasses.replace(found, extended=with_open_joints(found.extended, findings))
    extended = found.extended
    rest = what_remains(found, readings, noise)
    findings = by_size((*findings, *_geometry(as_found, evaluated, rest)))
    proposals = NONE_ASKED if offers is None else _proposals(found, cell, offers)
    kinds = {
        "time": time_blocks(readings.configuration, REPORTED["time"]),
        "posture": posture_blocks(readings.q, readings.configuration, REPORTED["posture"]),
    }
    left = {kind: (null.held_out(blocks), extended.held_out(blocks)) for kind, blocks in kinds.items()}
    physics = found.parts(anomalies=False)
    effects = _effects(extended, physics)
    model = extended.parameters.replace(effects=_applied(extended, effects))
    compliance, covariance = positions_compliance(extended)
    before = evaluated.nominal.replace(compliance=null.parameters.compliance)
    return Diagnosis(
        verdict=rest.verdict(found=bool(findings)),
        findings=findings,
        anomalies=(*_beside_findings(identification, rest, physics), *anomalies, *shift_anomalies(found, readings)),
        rest=rest,
        next_measurements=proposals.measurements,
        next_text=proposals.text,
        identification=identification,
        stiffness=_stiffness(extended),
        rms_before=rms(null.left),
        rms_after=rms(extended.left),
        rms_used=None if extended.model.used.all() else rms(extended.left[extended.model.used]),
        held_out_before=rms(left["time"][0]),
        held_out_after=rms(left["time"][1]),
        noise=noise,
        level=0.0,
        located=found.selection.refused,
        residual=extended.left,
        residual_before=null.left,
        shift=extended.shift(physics),
        moved=_moved(found),
        used=extended.model.used,
        compliance=compliance,
        compliance_covariance=covariance,
        blocks={kind: (rms_length(before), rms_length(after)) for kind, (before, after) in left.items()},
        test=None if test is None else tested_on(test, cell, model, before, with_frames=True),
        model=model,
        estimate=positions_estimate(extended, model, effects, cell),
    )


def _beside_findings(null: Identification, rest: Rest, physics: Sequence[int]) -> tuple[Anomaly, ...]:
    """Return what the null model says of the data, without noise that its misfit alone shows and physics explains."""
    explained = physics and not rest.significant and null.noise.seen_without_model is None
    return tuple(one for one in null.anomalies if not (explained and one.kind == "noise_understated"))


def _effects(extended: Extended, physics: Sequence[int]) -> tuple[int, ...]:
    """Return the parts that a model file holds as effects: all but compliances, which stand in it by themselves."""
    held = extended.parameters.compliance

    def stands(k: int) -> bool:
        nothing = not np.any(extended.value[extended.block(k)])
        return is_axial(extended.parts[k].candidate) and (nothing or held[_joint(extended, k)] > 0)

    return tuple(k for k in physics if not stands(k))


def _applied(extended: Extended, effects: Sequence[int]) -> tuple[AppliedEffect, ...]:
    """Return effects for a model file."""
    beyond = [(k, extended.value[extended.block(k)] - extended.held[extended.block(k)]) for k in effects]
    return tuple(applied(extended.parts[k].candidate, value, extended.model.state) for k, value in beyond)


def _joint(extended: Extended, part: int) -> int:
    return extended.parameters.joints.index(str(extended.parts[part].candidate.location["joint"]))


def _geometry(found: Estimate, evaluated: Evaluated, rest: Rest) -> tuple[Finding, ...]:
    """Return the joints whose geometry is far from where the cell file, or the given model, puts it.

    Geometry is fitted to whatever else is missing, too: beside a significant residual only what dwarfs it is believed.
    """
    staged = evaluated.staged
    gain = 1 - (staged.final.held_out_rms / staged.frames.held_out_rms) ** 2
    least = DWARFS * rest.rms if rest.significant else 0.0
    return tuple(one for one in geometry_findings(found.extended, evaluated.nominal, gain) if one.magnitude > least)


def _proposals(found: Estimate, cell: Cell, offers: Offers) -> Proposals:
    hypotheses, accepted = found.offered.hypotheses, found.selection.accepted
    physics = [i for i in accepted if hypotheses[i].family != FAMILY]
    places = [hypotheses[i].place for i in physics]
    single = [i for i in physics if places.count(hypotheses[i].place) == 1]
    equal = {i: equivalents(found.search, found.selection, (i,)) for i in single}
    sizes = dict(zip(accepted, map(float, found.selection.sizes.size), strict=True))
    for index, rivals in equal.items():
        size = found.search.scores(tuple(i for i in accepted if i != index)).size_after
        sizes |= {rival: float(size[found.search.place[rival]]) for rival, _ in rivals if rival not in sizes}
    noise = max(float(np.sqrt(found.selection.sizes.variance)), 1.0)
    return propose_postures(Known(found.field, sizes, accepted, equal, found.null.model, noise), cell, offers)


def _stiffness(extended: Extended) -> dict[str, tuple[float, float]]:
    """Return joint -> (stiffness, standard deviation) of compliances that were fitted, N*m/rad.

    At rest the weight alone shows them: of masses that are guesses none follows.
    """
    found: dict[str, tuple[float, float]] = {}
    if extended.model.problem.load is None and not extended.model.problem.chain.inertials_known:
        return found
    for k, part in enumerate(extended.parts):
        if is_axial(part.candidate):
            value, covariance = extended.values_of(k)
            compliance, std = float(value[0]), float(np.sqrt(covariance[0, 0]))
            if compliance > 2 * std:
                found[str(part.candidate.location["joint"])] = (1 / compliance, std / compliance**2)
    if extended.model.problem.load is None:
        return found
    first = extended.flat - len(extended.model.fitted_compliances)
    for k, one in enumerate(extended.model.fitted_compliances):
        joint = str(one.location["joint"])
        compliance = float(extended.parameters.compliance[extended.parameters.joints.index(joint)])
        std = float(np.sqrt(extended.covariance[first + k, first + k]))
        found[joint] = (1 / compliance, std / compliance**2) if compliance > 0 else (np.inf, np.inf)
    return found


def diagnose_mixed(
    readings: Readings,
    cell: Cell,
    options: Options,
    test: Readings | None = None,
    offers: Offers | None = None,
    identified: Identification | None = None,
) -> Diagnosis:
    """Say what the model of a recording leaves out that holds postures at rest and loaded ones, any number of either.

    Rows are in the order of time; arguments as `diagnose`.

    Raises:
        InputError: As `identify_absolute`, and as `prepare_loaded` where several configurations were loaded.
    """
    identification = fit_freed(readings, cell, options, test) if identified is None else identified
    fits = _both(identification, readings, cell, options)
    prepared, still, evaluated = fits.loaded, fits.rows, fits.case
    if prepared is None:
        used = np.ones(len(readings), dtype=bool)
        used[still] = evaluated.used
        found = estimate(readings, cell, evaluated, used)
        return diagnosis_of(found, evaluated, identification, cell, test=test, offers=offers)
    checked = check_each(prepared, lambda problem: loaded_state(problem, cell, prepared.fit.compliance))
    used = checked.sound & prepared.rejection.used
    used[still] &= evaluated.used  # gross errors that only the geometry shows
    found = estimate(readings, cell, evaluated, used)
    if found.parts(anomalies=True):  # what moved makes gross errors of sound readings
        identification = fit_freed(_freed(found, readings), cell, options, test)
        evaluated = _both(identification, _freed(found, readings), cell, options).case
        used = checked.sound & prepared.rejection.used
        used[still] &= evaluated.used
        found = estimate(readings, cell, evaluated, used)
    claimed = coordinate_std(prepared.problem.noise[prepared.rejection.used])
    unsettled = (a for a in identification.anomalies if a.kind == "unsettled")
    anomalies = (*checked.anomalies, *_of_readings(found, checked, claimed), *unsettled)
    silent = dataclasses.replace(identification, anomalies=())
    result = diagnosis_of(found, evaluated, silent, cell, test=test, offers=offers, anomalies=anomalies)
    result = dataclasses.replace(result, aliases=aliases(found.extended.model.state, differences=False))
    open_joints = any(joint.open for joint in identification.stiffness)
    if offers is None or result.next_measurements or not open_joints:
        return result
    # no posture shows what no load has shown
    loads = propose_loads(prepared, np.flatnonzero(used), cell, offers)
    if not loads.measurements:
        return result
    return dataclasses.replace(result, next_measurements=loads.measurements, next_text=loads.text)


def _both(identification: Identification, readings: Readings, cell: Cell, options: Options) -> BothFits:
    basis = identification.basis
    return basis if isinstance(basis, BothFits) else fit_both(readings, cell, options)


def _of_readings(found: Estimate, checked: Checked, claimed: float) -> tuple[Anomaly, ...]:
    """Return what single readings show: noise beyond the claim (m), and gross errors under the extended model."""
    readings, used = found.extended.model.readings, found.extended.model.used
    aside = checked.sound & ~used
    size = float(np.linalg.norm(found.extended.left, axis=1)[aside].max(initial=0.0))
    triangle = rigid_triangle(readings.position, readings, used)
    loose = any(anomaly.kind == "loose_target" for anomaly in checked.anomalies)
    noise: tuple[Anomaly, ...] = ()
    if triangle is not None and not loose:
        own = triangle.seen / claimed
        noise = noise_understated(Scatter((own, own, own), 0.0, 0.0, triangle.degrees_of_freedom), claimed)
    return (*noise, *outlier_readings(aside, size, readings))
