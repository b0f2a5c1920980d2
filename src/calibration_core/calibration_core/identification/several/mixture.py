"""Loaded configurations beside postures at rest: the geometry from positions at rest, the stiffness from the loads."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.absolute.evaluate import Evaluated, evaluate_absolute, identification_of
from calibration_core.identification.checks.exclusion_anomalies import OUTLIERS, outliers_of
from calibration_core.identification.geometry.fit import normal_equations
from calibration_core.identification.geometry.named_estimate import model_paths
from calibration_core.identification.geometry.terms import ElasticityTerm
from calibration_core.identification.result.estimate import Fit, Identification, ParameterEstimate, Residuals
from calibration_core.identification.standard.decoupled import identify_loaded
from calibration_core.identification.statistics.sizes import rms
from calibration_core.identification.stiffness.loaded import Options, identify_steps
from calibration_core.identification.stiffness.tested import tested_on
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.nominal import nominal_parameters
from calibration_core.observations.kinds import at_rest, standing
from calibration_core.timeseries import Bool1D, Float2D, Readings

COMPLIANCE = "compliance."
GEOMETRY = "geometry."


@dataclasses.dataclass(frozen=True, eq=False)
class Standing:
    """What the positions at rest show.

    Attributes:
        rows: (m,) which readings of the recording they are.
        case: Frames and geometry.
        found: The same in values and figures.
    """

    rows: Bool1D
    case: Evaluated
    found: Identification


def identify_mixture(readings: Readings, cell: Cell, options: Options, test: Readings | None = None) -> Identification:
    """Identify stiffness from the loaded steps, on the geometry that the positions at rest show.

    Raises:
        InputError: As `prepare_loaded` and `evaluate_absolute`.
    """
    start = nominal_parameters(cell) if options.start is None else options.start
    loaded = identify_steps(readings, cell, options)
    if readings.recording is None:  # frames of merged set-ups were known before; a single one shows its own
        start = loaded.model.replace(geometry=start.geometry, compliance=start.compliance)
    rows = standing(readings)
    some = readings.select(rows)
    believed = start.replace(compliance=loaded.model.compliance)
    case = evaluate_absolute(
        some,
        cell,
        robust=options.robust,
        readmit=options.readmit,
        believed=believed,
        corrected=options.corrected,
    )
    still = Standing(rows, case, identification_of(case, some, cell))
    started = dataclasses.replace(options, start=start.replace(geometry=still.found.model.geometry))
    found = _with_geometry(identify_loaded(readings, cell, started), still, cell)
    if test is None:
        return found
    before = case.nominal.replace(compliance=start.compliance)
    return dataclasses.replace(found, test=tested_on(test, cell, found.model, before, with_frames=True))


def _with_geometry(found: Identification, still: Standing, cell: Cell) -> Identification:
    """Return the answer of the loaded steps with geometry, residuals and exclusions of the positions at rest."""
    estimate = _beside(found.estimate, still, cell)
    seen = {(one.configuration, one.step, one.point) for one in found.exclusions}
    further = [one for one in still.found.exclusions if (one.configuration, one.step, one.point) not in seen]
    exclusions = (*found.exclusions, *further)
    kinds = {OUTLIERS, *(one.kind for one in found.anomalies)}
    anomalies = [one for one in found.anomalies if one.kind != OUTLIERS]
    anomalies += [one for one in still.found.anomalies if one.kind not in kinds]
    residuals, fit = _figures(found, still)
    return dataclasses.replace(
        found,
        method=f"{found.method}; geometry from all postures at rest ({still.found.method})",
        parameters=(*found.parameters, *_geometry_parameters(still, estimate, cell)),
        unidentified=(*found.unidentified, *still.found.unidentified),
        exclusions=exclusions,
        anomalies=(*outliers_of(exclusions), *anomalies),
        residuals=residuals,
        fit=fit,
        estimate=estimate,
    )


def _geometry_parameters(still: Standing, estimate: GaussianEstimate, cell: Cell) -> list[ParameterEstimate]:
    """Return the corrections of the geometry with the standard deviations of an estimate."""
    std, paths = dict(zip(estimate.names, estimate.std, strict=True)), model_paths(cell)
    return [
        dataclasses.replace(one, std=float(std.get(paths[one.name], one.std)))
        for one in still.found.parameters
        if one.group == "geometry"
    ]


def _beside(found: GaussianEstimate, still: Standing, cell: Cell) -> GaussianEstimate:
    """Return what loads and postures at rest show as one: the geometry is as uncertain as the compliances make it.

    At rest the robot sags by its compliances, which the loads have shown: an error of them is taken for geometry, with
    the sensitivity J = -(A^T A)^-1 A^T B of whitened columns A of what is fitted at rest and B of the compliances.
    """
    known = still.found.estimate
    geometry = known.chosen([k for k, name in enumerate(known.names) if name.startswith(GEOMETRY)])
    whole = GaussianEstimate.independent((found, geometry))
    case, joints = still.case, cell.robot.joints
    places = {name: row for row, name in enumerate(found.names)}
    held = [j for j, name in enumerate(joints) if _known(found, places.get(f"{COMPLIANCE}{name}"))]
    if case.staged.elastic or not held or not geometry.names:
        return whole
    fit, paths = case.staged.final.fit, model_paths(cell)
    terms = [*fit.terms, ElasticityTerm(tuple(held), tuple(joints[j] for j in held))]
    used = case.problem.select(np.flatnonzero(case.used))
    matrix, p = normal_equations(used, fit.parameters, terms).matrix, len(fit.names)
    answer = -np.linalg.solve(fit.normal.matrix, matrix[:p, p:])
    fitted = [paths.get(name) for name in fit.names]
    sensitivity = answer[[fitted.index(name) for name in geometry.names]]
    rows = [places[f"{COMPLIANCE}{joints[j]}"] for j in held]
    n = len(found.names)
    covariance = np.array(whole.covariance)
    shared = found.covariance[:, rows] @ sensitivity.T
    covariance[:n, n:], covariance[n:, :n] = shared, shared.T
    covariance[n:, n:] += sensitivity @ found.covariance[np.ix_(rows, rows)] @ sensitivity.T
    return dataclasses.replace(whole, covariance=covariance)


def _known(found: GaussianEstimate, row: int | None) -> bool:
    return row is not None and bool(np.isfinite(found.covariance[row, row]))


def _figures(found: Identification, still: Standing) -> tuple[Residuals, Fit]:
    """Return residuals and figures over all readings: loaded steps say nothing of postures at rest, positions do."""
    posture = at_rest(found.readings) & still.rows
    some = posture[still.rows]
    loaded, own, figures = found.residuals, still.found.residuals, found.fit
    residual, held_out = loaded.residual.copy(), loaded.held_out.copy()
    sigma, excluded = loaded.sigma.copy(), loaded.excluded.copy()
    residual[posture], held_out[posture], sigma[posture] = own.residual[some], own.held_out[some], own.sigma[some]
    excluded[posture] = own.excluded[some]
    before = still.case.staged.frames
    lengths = np.linalg.norm(held_out, axis=1)
    together = dataclasses.replace(
        loaded,
        measured=loaded.predicted + residual,
        residual=residual,
        held_out=held_out,
        sigma=sigma,
        excluded=excluded,
    )
    return together, dataclasses.replace(
        figures,
        rms_before=_with_further(figures.rms_before, before.residual.T[some], len(residual)),
        rms_after=rms(residual),
        held_out_rms_before=_with_further(figures.held_out_rms_before, before.held_out.T[some], len(residual)),
        held_out_rms_after=rms(held_out),
        held_out_mean_after=float(lengths.mean()),
        held_out_max_after=float(lengths.max()),
        rms_used=rms(residual[~excluded]),
    )


def _with_further(figure: float, further: Float2D, count: int) -> float:
    """Return the root mean square of `count` readings, m, in which further ones, (k, 3) m, counted as zero."""
    return float(np.sqrt(figure**2 + np.sum(further**2) / (3 * count)))
