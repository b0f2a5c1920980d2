"""The calibration from end to end: base frame, geometry, wrist centre, points, stiffness (CWA 17384, 7.1 to 7.6).

A cell with nothing but a nominal robot description is enough: one recording that holds the phases, one after another,
becomes Table 2.  Every phase takes over what the earlier ones found together with its full covariance (`prior`).

Joint stiffness with what earlier phases left uncertain: frames, points and geometry are nuisances with covariance.

The deflections depend on them through levers and directions.  Beside the columns of the compliances stand those of
the nuisances, by differences on the deformed geometry, and their information from earlier phases is added; offsets are
eliminated as ever.  Residuals, exclusions and proofs are those of any loaded recording.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.checks.conditions import with_temperature_of
from calibration_core.identification.checks.noise_audit import anomalies_of
from calibration_core.identification.circle_point.joint_axes import BaseFrame
from calibration_core.identification.geometry.fit import moved
from calibration_core.identification.geometry.parameter_table import (
    GaussianPrior,
    Uncertainty,
    difference,
    named_estimate,
    parameter_table,
    uncertainty_of,
)
from calibration_core.identification.geometry.terms import (
    AXES,
    PointTerm,
    TermContext,
    TrackerTerm,
    names_of,
    places_of,
)
from calibration_core.identification.result.estimate import (
    BASE_FRAME,
    GEOMETRY,
    POINTS,
    STIFFNESS,
    WRIST_CENTRE,
    Anomaly,
    Identification,
    NoiseAudit,
    PhaseEstimate,
    StandardGeometry,
)
from calibration_core.identification.standard.decoupled import with_decoupled
from calibration_core.identification.standard.kinematic_phases import (
    Kinematics,
    PhaseRows,
    identify_kinematics,
    split,
    standard_geometry,
)
from calibration_core.identification.statistics import Solution, scaled_inverse, solve_non_negative
from calibration_core.identification.stiffness.fit import (
    CONVERGED,
    LoadedFit,
    fit_compliance,
    normal_of,
    reject_outliers,
)
from calibration_core.identification.stiffness.loaded import Options, PreparedLoaded, identify_prepared, require_load
from calibration_core.identification.stiffness.problem import Linearised, LoadedProblem, build_problem
from calibration_core.identification.wrist import WristCentre
from calibration_core.model.chain import Chain, xyz_rpy
from calibration_core.model.identified.named_values import POSE
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Readings

WRENCH_POINT = "wrench_point"  # a measurement point of this name is the wrench point, measured like the others
STEP = 1e-6  # m and rad, of the differences by which the nuisances' columns are found
ITERATIONS = 6


@dataclasses.dataclass(frozen=True, eq=False)
class FitWithPrior:
    """A loaded recording fitted on top of earlier phases.

    Attributes:
        prepared: What `identify_prepared` takes.
        known: Frames, points and geometry after the loaded readings, compliances left aside.
        covariance: (n + p, n + p) of the compliances and of the parameters of `known`, for the claimed noise; in that
            of the compliances the uncertainty of what stays nominal, with the others taking up the difference.
    """

    prepared: PreparedLoaded
    known: GaussianPrior
    covariance: Float2D


def fit_with_prior(readings: Readings, cell: Cell, options: Options, known: GaussianPrior) -> FitWithPrior:
    """Fit the compliances of a loaded recording; frames, points and geometry come from earlier phases.

    Args:
        readings: The loaded configurations.
        cell: The cell file.
        options: How to evaluate; `start` says what is believed of the compliances.
        known: Frames, points and geometry, without compliances.

    Raises:
        IdentificationError: Fewer than two steps everywhere, or no load.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    require_load(readings)
    nominal = nominal_parameters(cell) if options.start is None else options.start
    believed = known.parameters.replace(compliance=nominal.compliance)
    case = _Case(readings, cell, chain_of(cell), options, known)
    problem = case.problem(believed)
    rejection = reject_outliers(problem, nominal.compliance, robust=options.robust, readmit=options.readmit)
    parameters = believed.replace(compliance=rejection.fit.compliance)
    total, solution = _normal(case, parameters, rejection.used), None
    for _ in range(ITERATIONS):
        solution, nuisance = _solved(total.matrix, total.vector, parameters.compliance, nominal.compliance)
        change = float(np.abs(solution.value - parameters.compliance).max())
        parameters = moved(parameters.replace(compliance=solution.value), known.terms, nuisance)
        total = _normal(case, parameters, rejection.used)
        if change <= 1e4 * CONVERGED * max(float(np.abs(solution.value).max()), 1e-30):
            break
    assert solution is not None  # noqa: S101 - there is at least one iteration
    parameters = case.with_wrench_point(parameters)
    problem = case.problem(parameters)
    some = problem.select(np.flatnonzero(rejection.used))
    plain = fit_compliance(some, parameters.compliance, options.deflections)
    normal = normal_of(some, some.linearise(parameters.compliance), options.deflections)
    n = len(parameters.compliance)
    covariance = _covariance(total, solution, known)
    solution = dataclasses.replace(solution, covariance=covariance[:n, :n])
    fit = LoadedFit(parameters.compliance, solution, plain.normal, float(normal.chi2.sum()), plain.freedom)
    prepared = PreparedLoaded(
        problem, dataclasses.replace(rejection, fit=fit), fit, nominal, parameters, None, "earlier phases"
    )
    after = dataclasses.replace(known, parameters=parameters, information=total.matrix[n:, n:], held=None)
    return FitWithPrior(prepared, after, covariance)


@dataclasses.dataclass(frozen=True, eq=False)
class _Case:
    """What does not change from one iteration to the next."""

    readings: Readings
    cell: Cell
    chain: Chain
    options: Options
    known: GaussianPrior

    def problem(self, parameters: ModelParameters) -> LoadedProblem:
        """Return the loaded problem with these frames, points and geometry."""
        parameters = self.with_wrench_point(parameters)
        chain = self.chain.corrected(parameters.geometry)
        how = self.options
        return build_problem(self.readings, self.cell, chain, parameters, method=how.method, weights=how.weights)

    def with_wrench_point(self, parameters: ModelParameters) -> ModelParameters:
        """Return the parameters with the wrench point where it was measured, if it was."""
        if f"{WRENCH_POINT} x" not in self.known.names:
            return parameters
        return parameters.replace(wrench_point=parameters.points[WRENCH_POINT])


@dataclasses.dataclass(frozen=True, eq=False)
class _Total:
    """Normal equations of compliances and nuisances together, prior information included.

    Attributes:
        matrix: (n + p, n + p).
        vector: (n + p,).
        across: (n + p, h) information between these and what stays nominal.
    """

    matrix: Float2D
    vector: Float1D
    across: Float2D


def _normal(case: _Case, parameters: ModelParameters, used: Bool1D) -> _Total:
    problem, known = case.problem(parameters), case.known
    linear = problem.linearise(parameters.compliance)
    columns = np.concatenate([linear.columns, _prior_columns(case, problem, parameters, linear)], axis=2)
    rows = np.flatnonzero(used)
    whole = Linearised(linear.predicted[rows], linear.residual[rows], columns[rows], linear.rows.select(rows))
    normal = normal_of(problem.select(rows), whole, case.options.deflections)
    n, end = len(parameters.compliance), len(parameters.compliance) + len(known.names)
    everything, vector = normal.matrix.sum(axis=0), normal.vector.sum(axis=0)[:end]
    matrix, across = everything[:end, :end].copy(), everything[:end, end:].copy()
    matrix[n:, n:] += known.information
    vector[n:] -= known.information @ difference(known.terms, known.parameters, parameters)
    if known.held is not None:
        across[n:] += known.held.across
    return _Total(matrix, vector, across)


def _prior_columns(case: _Case, problem: LoadedProblem, parameters: ModelParameters, linear: Linearised) -> Float3D:
    """Return minus the derivative of the residual by the parameters of `known` and by what it holds, (m, 3, p + h).

    Tracker pose and points as any absolute position has them; geometry, which also changes the torques of the load and
    with them the deflection, by differences.
    """
    rest, readings = problem.rest(parameters.compliance), problem.readings
    target, measured = linear.predicted.T, problem.measured.T
    view = TermContext(problem.chain, parameters, rest.at, target, measured, readings.point, rest)
    held = case.known.held
    terms = case.known.terms if held is None else (*case.known.terms, held.term)
    p = len(names_of(terms))
    columns = np.zeros((p, 3, len(readings)))
    for term, place in places_of(terms):
        if isinstance(term, TrackerTerm):
            term.write(view, columns[place])
        elif isinstance(term, PointTerm) and term.point != WRENCH_POINT:
            if term.point in readings.points:
                PointTerm(term.point, readings.points.index(term.point), term.axes).write(view, columns[place])
        else:
            for k in range(place.start, place.stop):
                step = np.zeros(p)
                step[k] = STEP
                shifted = case.problem(moved(parameters, terms, step))
                columns[k] = (linear.residual - shifted.residual(parameters.compliance)).T / STEP
    return np.moveaxis(columns, -1, 0).transpose(0, 2, 1)


def _solved(matrix: Float2D, vector: Float1D, compliance: Float1D, believed: Float1D) -> tuple[Solution, Float1D]:
    """Solve for the compliances with the nuisances eliminated, and return these nuisances' step."""
    n = len(compliance)
    across = matrix[n:, :n]
    inverse = np.linalg.solve(matrix[n:, n:], np.column_stack([across, vector[n:]]))
    reduced = matrix[:n, :n] - across.T @ inverse[:, :n]
    right = vector[:n] - across.T @ inverse[:, n]
    solution = solve_non_negative((reduced + reduced.T) / 2, right + reduced @ compliance, believed)
    step = solution.value - compliance
    return solution, inverse[:, n] - inverse[:, :n] @ step


def _covariance(total: _Total, solution: Solution, known: GaussianPrior) -> Float2D:
    """Return the covariance of everything; infinite where a compliance is not determined.

    What stays nominal is in error by dh; the solution is then off by -N^-1 A dh, with A the information across
    (consider covariance, Schmidt 1966).  That counts for the compliances; frames, points and geometry are stated as
    they belong to these nominal values.
    """
    matrix, n = total.matrix, len(solution.value)
    kept = np.r_[solution.determined, np.ones(len(matrix) - n, dtype=bool)]
    inverse = scaled_inverse(matrix[np.ix_(kept, kept)])
    if known.held is not None:
        off = inverse @ total.across[kept] * known.held.std
        off[int(solution.determined.sum()) :] = 0.0
        inverse = inverse + off @ off.T
    covariance = np.zeros_like(matrix)
    covariance[np.ix_(kept, kept)] = inverse
    covariance[~kept, ~kept] = np.inf
    return covariance


# --- the calibration from end to end ----------------------------------------------------------------------------------


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
        basis=None,
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
