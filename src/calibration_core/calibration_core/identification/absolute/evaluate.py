"""Absolute recordings: frames, geometry and gravity's elasticity from the position of single points."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.absolute.gross_errors import (
    GrossErrorRejection,
    audit_absolute,
    compare_neighbours,
    reject_gross_errors,
)
from calibration_core.identification.absolute.prediction_error import folds
from calibration_core.identification.absolute.staged_selection import (
    SelectionCase,
    StagedSelection,
    select_stages,
)
from calibration_core.identification.checks.conditions import check_preconditions
from calibration_core.identification.checks.noise_audit import (
    anomalies_of,
    exclusion,
    out_of_shape,
    overstated,
    rigid_triangle,
    window_scatter,
)
from calibration_core.identification.checks.space import operating_space
from calibration_core.identification.geometry.fit import (
    AbsoluteProblem,
    GeometryFit,
    absolute_problem,
    nominal_with_tracker,
    start_parameters,
)
from calibration_core.identification.geometry.identifiability import (
    ParameterSelection,
    candidates,
    select_frames,
    select_identifiable,
)
from calibration_core.identification.geometry.parameter_table import (
    COMPLIANCE,
    Uncertainty,
    named_estimate,
    parameter_table,
    uncertainty_of,
)
from calibration_core.identification.geometry.terms import AXES, Term, names_of
from calibration_core.identification.result.estimate import (
    Exclusion,
    Fit,
    Identification,
    JointStiffness,
    NoiseAudit,
    Residuals,
    Unidentified,
)
from calibration_core.identification.result.observability import stiffness_table
from calibration_core.identification.statistics import Solution, column_scale, rms
from calibration_core.identification.stiffness.fit import Key
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.tested import tested_on
from calibration_core.model.effects.candidate import typical
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import gravity_torque, load_torque
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.timeseries import Bool1D, Float2D, Float3D, Note, Readings

UNLOADED_TORQUE = 1e-6  # N*m
RELATIVE = "the masses are guesses: the weight shows it relative to them alone"
STATED = "stated_compliance"  # in the table of typical magnitudes: how far it is off, relative to its value


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluated:
    """The recording with all decisions taken.

    Attributes:
        problem: All readings.
        nominal: What the cell file predicts (with the best tracker pose where it states none).
        hidden: Point coordinates that stay nominal, and why.
        choice: Geometry that can be identified.
        used: (m,) readings used.
        rejection: The last search for gross errors; None without.
    """

    problem: AbsoluteProblem
    nominal: ModelParameters
    terms: list[Term]
    hidden: tuple[Unidentified, ...]
    choice: ParameterSelection
    staged: StagedSelection
    used: Bool1D
    rejection: GrossErrorRejection | None


def identify_absolute(
    readings: Readings, cell: Cell, options: Options | None = None, test: Readings | None = None
) -> Identification:
    """Identify frames, geometry and, where the recording proves it, elasticity from absolute positions.

    Args:
        readings: The recording; every configuration has a single step (more do no harm).
        cell: The cell file.
        options: How to evaluate.
        test: A second recording, predicted but not fitted.

    Raises:
        CellError: A wrench was recorded and a frame for it is missing.
        IdentificationError: Too few configurations, positions on one line, or differences instead of positions.
    """
    return identification_of(evaluate_absolute(readings, cell, options), readings, cell, test=test)


def identification_of(
    case: Evaluated, readings: Readings, cell: Cell, *, test: Readings | None = None
) -> Identification:
    """Say in values and figures what was decided."""
    chain = case.problem.chain
    covariance = position_covariance(readings, cell)
    result = case.staged.final.fit
    parameters = result.parameters
    noise = _audit(case, readings, covariance)
    uncertainty = uncertainty_of(parameters, result.names, result.covariance(noise.scale))
    space = operating_space(chain.corrected(parameters.geometry), parameters, readings)
    figures = _figures(case, covariance, result)
    exclusions = _exclusions(case, readings)
    return Identification(
        kind="absolute",
        method=_method(case),
        readings=readings,
        stiffness=_stiffness(case, uncertainty, noise, result),
        parameters=parameter_table(cell, parameters, uncertainty, case.choice, case.problem.names),
        names=uncertainty.names,
        covariance=uncertainty.covariance,
        condition_number=_condition(result),
        fit=figures,
        noise=noise,
        stages=case.staged.stages,
        unidentified=(*case.hidden, *case.choice.unidentified),
        exclusions=exclusions,
        anomalies=(*overstated(noise), *anomalies_of(noise, exclusions, readings)),
        preconditions=check_preconditions(readings, cell, space, figures.noise),
        residuals=_residuals(case, readings, covariance, noise.scale),
        space=space,
        model=parameters,
        test=None if test is None else tested_on(test, cell, parameters, case.nominal, with_frames=True),
        notes=(*readings.notes, *_notes(case)),
        estimate=named_estimate(uncertainty.names, uncertainty.covariance, parameters, cell),
        basis=case,
    )


def evaluate_absolute(readings: Readings, cell: Cell, options: Options | None = None) -> Evaluated:
    """Take all decisions: gross errors, identifiable geometry, stages of the model; arguments as `identify_absolute`.

    Raises:
        CellError: A wrench was recorded and a frame for it is missing.
        IdentificationError: Too few configurations, positions on one line, or differences instead of positions.
    """
    options = options or Options()
    robust, believed, corrected = options.robust, options.start, options.corrected
    nominal = nominal_parameters(cell) if believed is None else believed
    known = believed is not None or cell.frames.tracker is not None
    problem = absolute_problem(readings, cell, chain_of(cell), nominal, position_covariance(readings, cell))
    start = start_parameters(problem, nominal)
    terms, hidden = select_frames(problem, start)
    start = start.replace(points={**start.points, **_unfitted_points(terms, start, nominal)})
    used = np.ones(len(readings), dtype=bool)
    protected = _protected(readings, options.readmit)
    rejection: GrossErrorRejection | None = None
    shapeless = out_of_shape(readings, coordinate_std(position_covariance(readings, cell))) & ~protected
    reject = functools.partial(reject_gross_errors, beyond=int(shapeless.sum()))
    if robust:
        rejection = reject(problem, start, terms, ~shapeless, protected)
        start, used = rejection.fit.parameters, rejection.used
    uncertainty = np.zeros(len(nominal.joints))
    if believed is None:  # what was given was measured
        uncertainty = typical(STATED, cell.robot.rated_load) * nominal.compliance
    choice = select_identifiable(problem.select(np.flatnonzero(used)), start, terms, candidates(cell))
    if robust and choice.chosen:
        rejection = reject(problem, start, [*terms, choice.term], used, protected)
        used = rejection.used
    stated = nominal_with_tracker(problem, nominal, start, known=known)
    fold = folds(readings.configuration)
    selected = SelectionCase(problem, used, fold, readings.configuration, uncertainty)
    staged = select_stages(selected, stated, start, terms, choice, corrected=corrected)
    if robust:
        final = staged.final.fit
        rejection = reject(problem, final.parameters, final.terms, used, protected, final.prior)
        if not np.array_equal(rejection.used, used):
            used = rejection.used
            again = dataclasses.replace(selected, used=used)
            staged = select_stages(again, stated, start, terms, choice, corrected=corrected)
    return Evaluated(problem, stated, terms, hidden, choice, staged, used, rejection)


def _unfitted_points(terms: list[Term], start: ModelParameters, nominal: ModelParameters) -> dict[str, Float2D]:
    """Put coordinates that no term fits back on their nominal values."""
    fitted = names_of(terms)
    points = {}
    for point, value in nominal.points.items():
        free = np.array([f"{point} {axis}" in fitted for axis in AXES])
        points[point] = np.where(free, start.points[point], value)
    return points


def _protected(readings: Readings, readmit: frozenset[Key]) -> Bool1D:
    names = readings.points
    keys = zip(readings.configuration, readings.step, readings.point, strict=True)
    return np.array([(int(c), int(s), names[p]) in readmit for c, s, p in keys])


def _audit(case: Evaluated, readings: Readings, covariance: Float3D) -> NoiseAudit:
    used = case.used
    result = case.staged.final.fit
    neighbours = compare_neighbours(
        readings.q[used], case.staged.final.residual[:, used], readings.point[used], readings.configuration[used]
    )
    checks = (rigid_triangle(readings.position, readings, used), window_scatter(readings, used))
    return audit_absolute(covariance[used], checks, neighbours, result.seen.cost, result.freedom)


def _stiffness(
    case: Evaluated, uncertainty: Uncertainty, noise: NoiseAudit, result: GeometryFit
) -> tuple[JointStiffness, ...]:
    joints, weighed = case.problem.chain.joints, case.problem.chain.inertials_known
    if not case.staged.elastic:
        return ()
    n = len(joints)
    spread = np.array([uncertainty.std(f"{COMPLIANCE}{joint}") for joint in joints])
    determined = np.isfinite(spread) & weighed
    variance = np.where(determined, (spread / noise.scale) ** 2, np.inf)
    value = result.parameters.compliance
    solution = Solution(
        value=value,
        unbounded=value,
        covariance=np.diag(variance),
        at_bound=determined & (value <= 0.0),
        determined=determined,
        condition_number=_condition(result),
        eigenvalues=np.ones(n),
        eigenvectors=np.eye(n),
    )
    chain = case.problem.chain.corrected(result.parameters.geometry)
    at = posture(chain, case.problem.q)
    load = case.problem.load
    torque = gravity_torque(chain, at) + (0.0 if load is None else load_torque(at, load))
    torque_rms = np.sqrt(np.mean(torque**2, axis=1))
    freedom = result.freedom if noise.scale > 1.0 else None
    table = stiffness_table(joints, solution, noise.scale, freedom, torque_rms, chain.prismatic, chain.rigid)
    return tuple(
        entry
        if j in case.staged.elastic and weighed
        else dataclasses.replace(
            entry,
            identifiable=False,
            reason=RELATIVE if j in case.staged.elastic else _unproven(float(torque_rms[j]), np.isfinite(spread[j])),
        )
        for j, entry in enumerate(table)
    )


def _unproven(torque: float, fitted: bool) -> str:
    if torque < UNLOADED_TORQUE and not fitted:
        return "not fitted: nothing loads this joint"
    how = "fitted beside the others, from the stated value on" if fitted else "not fitted"
    return f"{how}: it does not clearly improve configurations left out (torque {torque:.2g} N·m rms)"


def _condition(result: GeometryFit) -> float:
    scale = column_scale(result.normal.matrix)
    values = np.linalg.eigvalsh(result.normal.matrix * np.outer(scale, scale))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")


def _figures(case: Evaluated, covariance: Float3D, result: GeometryFit) -> Fit:
    before, after = case.staged.frames, case.staged.final
    lengths = np.linalg.norm(after.held_out, axis=0)
    return Fit(
        rms_before=rms(before.residual),
        rms_after=rms(after.residual),
        held_out_rms_before=rms(before.held_out),
        held_out_rms_after=rms(after.held_out),
        noise=coordinate_std(covariance),
        held_out_mean_after=float(lengths.mean()),
        held_out_max_after=float(lengths.max()),
        rms_used=rms(after.residual[:, case.used]),
        chi2=result.seen.cost,
        degrees_of_freedom=result.freedom,
    )


def _residuals(case: Evaluated, readings: Readings, covariance: Float3D, scale: float) -> Residuals:
    final = case.staged.final
    tracker = final.fit.parameters.tracker
    measured = readings.position @ tracker[:3, :3].T + tracker[:3, 3]
    variance = np.einsum("ai,mij,aj->ma", tracker[:3, :3], covariance, tracker[:3, :3], optimize=True)
    force = np.zeros(len(readings)) if readings.wrench is None else np.linalg.norm(readings.wrench[:, :3], axis=1)
    return Residuals(
        measured=measured,
        predicted=measured - final.residual.T,
        residual=final.residual.T,
        held_out=final.held_out.T,
        sigma=scale * np.sqrt(variance),
        load=force,
        excluded=~case.used,
    )


def _exclusions(case: Evaluated, readings: Readings) -> tuple[Exclusion, ...]:
    rejection = case.rejection
    if rejection is None:
        return ()
    held_out = np.linalg.norm(case.staged.final.held_out, axis=0)
    found = []
    for row in np.flatnonzero(~case.used):
        ratio = float(np.sqrt(rejection.squared[row] / rejection.threshold))
        reason = (
            f"{held_out[row] * 1e3:.3f} mm from where the other configurations and the model put it, "
            f"{ratio:.2f} times the limit that this recording's own scatter sets"
        )
        found.append(exclusion(readings, int(row), reason, held_out[row], rejection.squared[row]))
    return tuple(found)


def _notes(case: Evaluated) -> tuple[Note, ...]:
    if case.rejection is None or not case.rejection.full:
        return ()
    count = int(np.sum(~case.used))
    text = f"{count} readings were excluded, the largest share allowed; more may be wrong"
    return (Note("many_outliers", "readings", text, count),)


def _method(case: Evaluated) -> str:
    kept = [stage.name for stage in case.staged.stages[1:] if stage.kept]
    return ", ".join(
        (
            "absolute positions",
            " + ".join(kept) + " by weighted Gauss-Newton (weights from the instrument's uncertainty)",
            "stages kept by cross-validation over whole configurations",
            "every reading used" if case.rejection is None else "gross errors excluded by name",
        )
    )
