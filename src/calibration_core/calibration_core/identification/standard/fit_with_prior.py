"""Joint stiffness with what earlier phases left uncertain: frames, points and geometry are nuisances with covariance.

The deflections depend on them through levers and directions.  Beside the columns of the compliances stand those of
the nuisances, by differences on the deformed geometry, and their information from earlier phases is added; offsets are
eliminated as ever.  Residuals, exclusions and proofs are those of any loaded recording.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry.fit import moved
from calibration_core.identification.geometry.prior import GaussianPrior, difference
from calibration_core.identification.geometry.terms import PointTerm, TermContext, TrackerTerm, names_of, places_of
from calibration_core.identification.statistics.solve import Solution, scaled_inverse, solve_non_negative
from calibration_core.identification.stiffness.fit import CONVERGED, LoadedFit, fit_compliance, normal_of
from calibration_core.identification.stiffness.loaded import Options, PreparedLoaded, require_load
from calibration_core.identification.stiffness.outlier_rejection import reject_outliers
from calibration_core.identification.stiffness.problem import Linearised, LoadedProblem, build_problem
from calibration_core.model.chain import Chain
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
    (consider covariance, Schmidt 1966).  That counts for the compliances; frames, points and geometry are told as they
    belong to these nominal values.
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
