"""The calibration from end to end: base frame, geometry, wrist centre, points, stiffness (CWA 17384, 7.1 to 7.6).

A cell with nothing but a nominal robot description is enough: one recording that holds the phases, one after another,
becomes Table 2.  Every phase takes over what the earlier ones found together with its full covariance (`prior`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.checks.exclusion_anomalies import anomalies_of
from calibration_core.identification.checks.preconditions import with_temperature_of
from calibration_core.identification.circle_point.joint_axes import BaseFrame
from calibration_core.identification.geometry.named_estimate import named_estimate
from calibration_core.identification.geometry.parameter_table import Uncertainty, parameter_table, uncertainty_of
from calibration_core.identification.geometry.prior import GaussianPrior
from calibration_core.identification.geometry.terms import AXES
from calibration_core.identification.result.estimate import Anomaly, Identification, NoiseAudit
from calibration_core.identification.result.phase import (
    BASE_FRAME,
    GEOMETRY,
    POINTS,
    STIFFNESS,
    WRIST_CENTRE,
    PhaseEstimate,
    StandardGeometry,
)
from calibration_core.identification.standard.decoupled import with_decoupled
from calibration_core.identification.standard.fit_with_prior import FitWithPrior, fit_with_prior
from calibration_core.identification.standard.kinematic_phases import Kinematics, PhaseRows, identify_kinematics, split
from calibration_core.identification.standard.standard_geometry import standard_geometry
from calibration_core.identification.stiffness.loaded import Options, identify_prepared
from calibration_core.identification.wrist.centre import WristCentre
from calibration_core.model.chain import xyz_rpy
from calibration_core.model.identified.named_values import POSE
from calibration_core.model.nominal import nominal_parameters
from calibration_core.timeseries import Float1D, Readings


def holds_phases(readings: Readings) -> bool:
    """Say whether a recording holds loaded configurations and, beside them, sweeps of single joints."""
    rows = split(readings)
    return bool(rows.loaded.any() and rows.sweeps.any())


def identify_phases(
    readings: Readings, cell: Cell, options: Options | None = None, test: Readings | None = None
) -> Identification:
    """Go through all phases of one recording, and identify the stiffnesses with what the others leave uncertain.

    What moves and what is loaded tells the phases apart; no marker is needed, and their order does not matter:

    - single-joint sweeps: at least five configurations of one step in a row in which one joint turns and the others
      stand (joints 1 and 2 for the base frame, further ones for the geometry);
    - wrist motion: a stretch in which the arm stands and the last three joints move together;
    - known configurations: any other unloaded configurations;
    - loaded configurations: unloaded and loaded steps.

    A node or script joins what it recorded in one recording (or several tables in one `Readings`, configurations
    numbered throughout) and calls this function, or `calibration identify` on the recording, which does the same.  The
    answer is that of a loaded recording: stiffnesses, `parameters` (tracker, points, geometry), `covariance` of all of
    them, `standard` (circles and spheres), and `phases`, one `PhaseEstimate` per phase present.  `wrench_point` is a
    measurement point of that name, if there is one.

    Args:
        readings: All phases.
        cell: The cell file: geometry, points and frames are first guesses; no tracker pose is needed.
        options: How to evaluate the loaded configurations.
        test: A second loaded recording that is predicted, not fitted.

    Raises:
        IdentificationError: Too few configurations, no load, or positions that are differences.
        CellError: A frame that the wrench needs is missing.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    options = options or Options()
    believed = nominal_parameters(cell) if options.start is None else options.start
    rows = split(readings)
    found = identify_kinematics(readings.select(rows.kinematic), cell, believed, robust=options.robust)
    known = found.final
    if any(name.startswith("C ") for name in known.names):
        known = known.without_compliances()
    fitted = fit_with_prior(readings.select(rows.loaded), cell, options, known)
    answer = identify_prepared(fitted.prepared, cell, options, test)
    scale = answer.noise.scale
    uncertainty = _everything(fitted, answer, scale)
    model = fitted.prepared.parameters
    geometry = _uncertainty(found.geometry)
    standard = standard_geometry(found.readings, cell, model, geometry.names, geometry.covariance)
    read = tuple(point for point in readings.points if point in model.points)
    wrist = None if standard.wrist is None else standard.wrist.flange
    answer = with_decoupled(answer, fitted.prepared, wrist)
    return dataclasses.replace(
        answer,
        method=f"{answer.method}; frames, points and geometry with their covariance from the phases before",
        parameters=parameter_table(cell, model, uncertainty, found.choice, read),
        names=uncertainty.names,
        covariance=uncertainty.covariance,
        unidentified=(*answer.unidentified, *found.hidden, *found.choice.unidentified),
        exclusions=(*answer.exclusions, *found.exclusions),
        anomalies=(*answer.anomalies, *_odd(found, answer.noise)),
        preconditions=with_temperature_of(answer.preconditions, readings),
        standard=standard,
        phases=_phases(found, rows, fitted, geometry, uncertainty, standard, scale),
        estimate=named_estimate(uncertainty.names, uncertainty.covariance, model, cell),
    )


def _odd(found: Kinematics, noise: NoiseAudit) -> tuple[Anomaly, ...]:
    """Return what is wrong with the kinematic readings; their notes stand with the others already."""
    quiet = dataclasses.replace(noise, understated=False)
    return anomalies_of(quiet, found.exclusions, dataclasses.replace(found.readings, notes=()))


def _everything(fitted: FitWithPrior, answer: Identification, scale: float) -> Uncertainty:
    """Return the covariance of compliances, tracker pose (x ... yaw), points and geometry together."""
    n = len(answer.names)
    names = (*fitted.known.names, *answer.names)
    p = len(fitted.known.names)
    order = np.r_[n : n + p, 0:n]
    undetermined = ~np.isfinite(np.diag(fitted.covariance))
    finite = np.where(np.isfinite(fitted.covariance), fitted.covariance, 0.0)[np.ix_(order, order)]
    result = uncertainty_of(fitted.known.parameters, names, finite, scale)
    covariance = result.covariance.copy()
    rows = np.flatnonzero(undetermined[:n])
    covariance[rows, rows] = np.inf
    return Uncertainty(result.names, covariance)


def _phases(
    found: Kinematics,
    rows: PhaseRows,
    fitted: FitWithPrior,
    geometry: Uncertainty,
    uncertainty: Uncertainty,
    standard: StandardGeometry,
    scale: float,
) -> tuple[PhaseEstimate, ...]:
    phases = []
    swept = int(found.rows.sweeps.sum())
    if standard.base is not None:
        phases.append(_base(standard.base))
    poses = int(found.rows.poses.sum())
    kept = tuple(name for name in geometry.names if not name.startswith("C ") and not _is_point(name, found))
    remarks = tuple(one.reason for one in found.choice.unidentified)
    phases.append(_part(GEOMETRY, swept + poses, geometry, found.geometry, kept, remarks))
    if standard.wrist is not None:
        phases.append(_wrist(standard.wrist, int(found.rows.wrist.sum())))
    final = _uncertainty(found.final)
    points = tuple(name for name in final.names if _is_point(name, found))
    hidden = tuple(one.reason for one in found.hidden)
    phases.append(_part(POINTS, poses, final, found.final, points, hidden))
    stiff = tuple(name for name in uncertainty.names if name.startswith("C "))
    index = [uncertainty.names.index(name) for name in stiff]
    compliance = fitted.prepared.parameters.compliance
    covariance = uncertainty.covariance[np.ix_(index, index)]
    phases.append(PhaseEstimate(STIFFNESS, int(rows.loaded.sum()), stiff, compliance, covariance, scale))
    return tuple(phases)


def _uncertainty(known: GaussianPrior) -> Uncertainty:
    return uncertainty_of(known.parameters, known.names, known.covariance)


def _is_point(name: str, found: Kinematics) -> bool:
    return name.rpartition(" ")[0] in found.readings.points


def _base(base: BaseFrame) -> PhaseEstimate:
    pose = xyz_rpy(base.tracker)
    names = tuple(f"tracker {label}" for label in POSE)
    count = sum(circle.points for axis in base.axes for circle in axis.circles)
    return PhaseEstimate(BASE_FRAME, count, names, pose, base.covariance, remarks=base.warnings)


def _wrist(wrist: WristCentre, count: int) -> PhaseEstimate:
    names = tuple(f"wrist centre {axis}" for axis in AXES)
    return PhaseEstimate(WRIST_CENTRE, count, names, wrist.flange, wrist.covariance, remarks=wrist.warnings)


def _part(
    phase: str,
    readings: int,
    uncertainty: Uncertainty,
    known: GaussianPrior,
    names: tuple[str, ...],
    remarks: tuple[str, ...],
) -> PhaseEstimate:
    index = [uncertainty.names.index(name) for name in names]
    covariance = uncertainty.covariance[np.ix_(index, index)]
    values = _values(known)
    return PhaseEstimate(
        phase, readings, names, np.array([values[name] for name in names]), covariance, known.scale, remarks
    )


def _values(known: GaussianPrior) -> dict[str, float]:
    tracker = known.parameters.tracker
    pose = xyz_rpy(tracker)
    values = {f"tracker {label}": float(value) for label, value in zip(POSE, pose, strict=True)}
    for term in known.terms[1:]:
        found: Float1D = term.values(known.parameters)
        values |= {name: float(value) for name, value in zip(term.names, found, strict=True)}
    return values
