"""A recording that holds loaded configurations and postures at rest: one set-up, which all unloaded positions show."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.absolute.evaluate import (
    Evaluated,
    evaluate_absolute,
    identification_of,
)
from calibration_core.identification.checks.noise_audit import OUTLIERS, outliers_of
from calibration_core.identification.geometry.fit import normal_equations
from calibration_core.identification.geometry.parameter_table import model_paths
from calibration_core.identification.geometry.terms import ElasticityTerm
from calibration_core.identification.result.estimate import (
    Fit,
    Identification,
    ParameterEstimate,
    Residuals,
)
from calibration_core.identification.several.merge import Member
from calibration_core.identification.standard.decoupled import identify_loaded
from calibration_core.identification.statistics import rms
from calibration_core.identification.stiffness.loaded import MIN_CONFIGURATIONS, Options, PreparedLoaded, prepare_loaded
from calibration_core.identification.stiffness.tested import tested_on
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.kinds import (
    at_rest,
    loaded_configurations,
    standing,
)
from calibration_core.timeseries import Bool1D, Float2D, Note, Readings

COMPLIANCE = "compliance."
GEOMETRY = "geometry."


@dataclasses.dataclass(frozen=True, eq=False)
class BothFits:
    """What either kind of readings shows by itself.

    Attributes:
        loaded: Compliances from the steps; None where too few configurations were loaded for a stiffness.
        rows: (m,) which readings of the recording are positions at rest.
        case: Frames and geometry from those, at these compliances.
    """

    loaded: PreparedLoaded | None
    rows: Bool1D
    case: Evaluated


def fit_both(readings: Readings, cell: Cell, options: Options) -> BothFits:
    """Fit the loaded steps, and with their compliances the positions at rest.

    Raises:
        InputError: As `prepare_loaded` and `evaluate_absolute`.
    """
    rows, loaded, believed = standing(readings), None, options.start
    if len(loaded_configurations(readings)) >= MIN_CONFIGURATIONS:
        loaded = prepare_loaded(readings, cell, options)
        believed = nominal_parameters(cell) if believed is None else believed
        if readings.recording is None:  # frames of merged set-ups were known before; a single one shows its own
            believed = loaded.parameters.replace(geometry=believed.geometry)
        believed = believed.replace(compliance=loaded.parameters.compliance)
    case = evaluate_absolute(readings.select(rows), cell, dataclasses.replace(options, start=believed))
    return BothFits(loaded, rows, case)


def _identify_both(readings: Readings, cell: Cell, options: Options, test: Readings | None = None) -> Identification:
    """Identify stiffness from the loaded steps, on the geometry that the positions at rest show.

    Raises:
        InputError: As `fit_both`.
    """
    fits = fit_both(readings, cell, options)
    still = identification_of(fits.case, readings.select(fits.rows), cell)
    nominal = nominal_parameters(cell) if options.start is None else options.start
    start = fits.case.nominal.replace(compliance=nominal.compliance)
    started = dataclasses.replace(options, start=start.replace(geometry=still.model.geometry))
    found = _with_geometry(identify_loaded(readings, cell, started), fits, still, cell)
    if test is None:
        return found
    return dataclasses.replace(found, test=tested_on(test, cell, found.model, start, with_frames=True))


def _with_geometry(found: Identification, fits: BothFits, still: Identification, cell: Cell) -> Identification:
    """Return the answer of the loaded steps with geometry, residuals and exclusions of the positions at rest."""
    estimate = _beside(found.estimate, fits.case, still.estimate, cell)
    seen = {(one.configuration, one.step, one.point) for one in found.exclusions}
    further = [one for one in still.exclusions if (one.configuration, one.step, one.point) not in seen]
    exclusions = (*found.exclusions, *further)
    kinds = {OUTLIERS, *(one.kind for one in found.anomalies)}
    anomalies = [one for one in found.anomalies if one.kind != OUTLIERS]
    anomalies += [one for one in still.anomalies if one.kind not in kinds]
    residuals, fit = _figures(found, fits, still)
    return dataclasses.replace(
        found,
        method=f"{found.method}; geometry from all postures at rest ({still.method})",
        parameters=(*found.parameters, *_geometry_parameters(still, estimate, cell)),
        unidentified=(*found.unidentified, *still.unidentified),
        exclusions=exclusions,
        anomalies=(*outliers_of(exclusions), *anomalies),
        residuals=residuals,
        fit=fit,
        estimate=estimate,
        basis=fits,
    )


def _geometry_parameters(still: Identification, estimate: GaussianEstimate, cell: Cell) -> list[ParameterEstimate]:
    """Return the corrections of the geometry with the standard deviations of an estimate."""
    std, paths = dict(zip(estimate.names, estimate.std, strict=True)), model_paths(cell)
    return [
        dataclasses.replace(one, std=float(std.get(paths[one.name], one.std)))
        for one in still.parameters
        if one.group == "geometry"
    ]


def _beside(found: GaussianEstimate, case: Evaluated, known: GaussianEstimate, cell: Cell) -> GaussianEstimate:
    """Return what loads and postures at rest show as one: the geometry is as uncertain as the compliances make it.

    At rest the robot sags by its compliances, which the loads have shown: an error of them is taken for geometry, with
    the sensitivity J = -(A^T A)^-1 A^T B of whitened columns A of what is fitted at rest and B of the compliances.
    """
    geometry = known.chosen([k for k, name in enumerate(known.names) if name.startswith(GEOMETRY)])
    whole = GaussianEstimate.independent((found, geometry))
    joints = cell.robot.joints
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


def _figures(found: Identification, fits: BothFits, still: Identification) -> tuple[Residuals, Fit]:
    """Return residuals and figures over all readings: loaded steps say nothing of postures at rest, positions do."""
    posture = at_rest(found.readings) & fits.rows
    some = posture[fits.rows]
    loaded, own, figures = found.residuals, still.residuals, found.fit
    residual, held_out = loaded.residual.copy(), loaded.held_out.copy()
    sigma, excluded = loaded.sigma.copy(), loaded.excluded.copy()
    residual[posture], held_out[posture], sigma[posture] = own.residual[some], own.held_out[some], own.sigma[some]
    excluded[posture] = own.excluded[some]
    before = fits.case.staged.frames
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


def identify_mixed(readings: Readings, cell: Cell, options: Options, test: Readings | None = None) -> Identification:
    """Identify stiffness and geometry from a recording that holds both kinds, any number of either.

    Returns:
        The answer of a loaded recording; where fewer than two configurations were loaded, that of postures at rest.

    Raises:
        InputError: The recording cannot be evaluated.
    """
    if readings.recording is not None:
        return _identify_both(readings, cell, options, test)
    if len(loaded_configurations(readings)) < MIN_CONFIGURATIONS:
        return _at_rest_alone(readings, cell, options, test)
    try:
        return _identify_both(readings, cell, options, test)
    except IdentificationError as error:
        text = f"the postures at rest are not used: {error}"
        return identify_loaded(readings.with_notes(Note("loaded_alone", "configuration", text)), cell, options, test)


def _at_rest_alone(readings: Readings, cell: Cell, options: Options, test: Readings | None) -> Identification:
    """Identify from positions at rest, where too few configurations were loaded for a stiffness."""
    count = len(loaded_configurations(readings))
    text = f"{count} with loaded steps is too few for a stiffness (at least {MIN_CONFIGURATIONS}): first steps are used"
    fits = fit_both(readings, cell, options)
    some = readings.select(fits.rows).with_notes(Note("few_loaded", "configuration", text, count))
    return dataclasses.replace(identification_of(fits.case, some, cell, test=test), basis=fits)


POINTS, TRACKER = "measurement_points.", "tracker."
SET_UP = ("tracker", "point")  # groups of parameters that belong to no robot


def of_set_up(model: ModelParameters, member: Member, alone: Identification) -> ModelParameters:
    """Return a model of several set-ups with tracker pose and points of one of them."""
    tracker = alone.model.tracker
    if model.setups is not None:
        tracker = model.tracker @ model.setups[member.number - 1] @ tracker
    points = {name: np.array(point) for name, point in member.cell.frames.measurement_points.items()}
    points |= {name: model.points[member.point(name)] for name in member.readings.points}
    return model.replace(tracker=tracker, points=points, setups=None)


def estimate_of_set_up(estimate: GaussianEstimate, member: Member, alone: Identification) -> GaussianEstimate:
    """Return what is known of the numbers of `of_set_up`: what is shared, and the set-up's own points and tracker.

    The tracker pose, and points that displacements do not show, are known as the set-up shows them by itself.
    """
    mark = f"@{member.number}."
    others = (POINTS, TRACKER)
    kept = [k for k, name in enumerate(estimate.names) if mark in name or not name.startswith(others)]
    shared = estimate.chosen(kept)
    shared = shared.renamed([name.replace(mark, ".") for name in shared.names])
    own = [k for k, name in enumerate(alone.estimate.names) if name.startswith(others) and name not in shared.names]
    return GaussianEstimate.independent((shared, alone.estimate.chosen(own)))
