"""Gauss-Newton on the compliances of a loaded recording, offsets eliminated.

Full pose instead of points: three or more points of a step make one rigid displacement of the tool.

Equation (6) of the standard then has six rows per step: three translations of the centroid and three rotations.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Literal

import numpy as np

from calibration_core.errors import EquilibriumError, IdentificationError
from calibration_core.identification.checks.noise_audit import exclusion
from calibration_core.identification.result.estimate import Exclusion
from calibration_core.identification.statistics import (
    Normal,
    Rows,
    Solution,
    deleted,
    deletion_limit,
    normal_equations,
    solve_non_negative,
)
from calibration_core.identification.stiffness.problem import Linearised, LoadedProblem
from calibration_core.policy import MOST_EXCLUDED, TAKEN_BACK
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Float4D, Int1D, Int2D, Readings

LEAST_POINTS = 3
MIN_SPREAD = 1e-3  # m: second singular value of the centred points; below it they lie on one line


def as_poses(problem: LoadedProblem, linear: Linearised, about: Float2D | None = None) -> tuple[Rows, Float2D, Float3D]:
    """Combine the points of every step into a displacement of the tool.

    Args:
        problem: The readings.
        linear: The problem at some compliances.
        about: (m, 3) m, base frame, the same for all readings of a step: the point of the tool whose translation is
            wanted; None: the centroid of the step's points.

    Returns:
        rows: Grouping and 6 x 6 noise of the steps with at least three points that are not collinear.
        residual: (s, 6) translation of that point (m) and rotation (rad), base axes, measured - predicted.
        columns: (s, 6, n) their derivatives by the compliances.

    Raises:
        IdentificationError: No step has three points that are not collinear.
    """
    readings = problem.readings
    steps, owner, count = np.unique(
        np.column_stack([problem.configuration, readings.step]), axis=0, return_inverse=True, return_counts=True
    )
    order, ends = np.argsort(owner.reshape(-1), kind="stable"), np.cumsum(count)
    parts = [_displaced(linear, order[ends[same, None] - k + np.arange(k)], about) for k, same in _equal(count)]
    if not sum(len(members) for members, *_ in parts):
        raise IdentificationError(
            readings.provenance.path,
            "points",
            "no step with three points off one line",
            "three such points (full pose)",
        )
    first, residual, columns, noise, shared = (np.concatenate(several) for several in zip(*parts, strict=True))
    in_order = np.argsort(owner.reshape(-1)[first])
    kept = owner.reshape(-1)[first][in_order]
    _, configuration = np.unique(steps[kept, 0], return_inverse=True)
    zeros = np.zeros(len(kept), dtype=np.int64)
    rows = Rows(configuration.astype(np.int64), zeros, np.arange(len(kept)), noise[in_order], shared[in_order])
    return rows, residual[in_order], columns[in_order]


def _equal(count: Int1D) -> Iterator[tuple[int, Int1D]]:
    """Yield the numbers of points of steps, three at least, and the steps that have so many."""
    for k in np.unique(count[count >= LEAST_POINTS]):
        yield int(k), np.flatnonzero(count == k)


def _displaced(
    linear: Linearised, members: Int2D, about: Float2D | None
) -> tuple[Int1D, Float2D, Float3D, Float3D, Float3D]:
    """Return the displacements of steps with equally many points.

    Args:
        linear: The problem at some compliances.
        members: (s, k) readings of the steps.
        about: As for `as_poses`.

    Returns:
        Of the steps of which the points are off one line: the first reading, (t,); residual, (t, 6); its derivatives,
        (t, 6, n); its noise, (t, 6, 6); what the shared wrench reading moves, (t, 6, w).
    """
    at = linear.predicted[members]
    arms = at - at.mean(axis=1, keepdims=True)
    spread = np.linalg.svd(arms, compute_uv=False)[:, 1] >= MIN_SPREAD
    members, at, arms = members[spread], at[spread], arms[spread]
    if about is not None:
        arms = at - about[members[:, 0], None]
    reduce, covariance = _rigid(arms, linear.rows.noise[members])
    steps, k = members.shape
    residual, columns, shared = (
        reduce @ values[members].reshape(steps, 3 * k, values.shape[2])
        for values in (linear.residual[:, :, None], linear.columns, linear.rows.shared)
    )
    return members[:, 0], residual[:, :, 0], columns, covariance, shared


def _rigid(arms: Float3D, noise: Float4D) -> tuple[Float3D, Float3D]:
    """Return the best linear map from displacements of a step's points to v, w, and the covariance of its result.

    Args:
        arms: (s, k, 3) m, points of every step.
        noise: (s, k, 3, 3) of their readings.

    Returns:
        (s, 6, 3 k) and (s, 6, 6).
    """
    steps, k, _ = arms.shape
    design = np.zeros((steps, k, 3, 6))
    design[..., :3] = np.eye(3)
    x, y, z = np.moveaxis(arms, -1, 0)
    design[..., 0, 4], design[..., 0, 5] = z, -y
    design[..., 1, 3], design[..., 1, 5] = -z, x
    design[..., 2, 3], design[..., 2, 4] = y, -x
    weighted = np.linalg.solve(noise, design).reshape(steps, 3 * k, 6).transpose(0, 2, 1)
    covariance = np.asarray(np.linalg.inv(weighted @ design.reshape(steps, 3 * k, 6)), dtype=np.float64)
    return covariance @ weighted, covariance


# --- gauss-Newton on the compliances of a loaded recording, offsets eliminated ----------------------------------------


Deflections = Literal["points", "pose"]
ITERATIONS = 12
CONVERGED = 1e-8  # of the largest compliance; what the next step would change is a thousandth of the last
NEARLY = 1e-4  # likewise, where a fit only says which readings to use


@dataclasses.dataclass(frozen=True, eq=False)
class LoadedFit:
    """The best compliances for one set of readings.

    Attributes:
        compliance: (n,) rad/(N*m), not negative.
        solution: How well they are determined (unit weight = the claimed noise).
        normal: Normal equations per configuration at the solution.
        chi2: Weighted sum of squares at the solution.
        freedom: Its degrees of freedom.
    """

    compliance: Float1D
    solution: Solution
    normal: Normal
    chi2: float
    freedom: int


def fit_compliance(
    problem: LoadedProblem,
    start: Float1D,
    deflections: Deflections = "points",
    near: Float1D | None = None,
    converged: float = CONVERGED,
) -> LoadedFit:
    """Fit the compliances by Gauss-Newton; K_CSM makes the problem slightly nonlinear (a few tenths of a percent).

    Args:
        problem: The readings to use.
        start: (n,) first guess, rad/(N*m); also the value of what the readings do not determine.
        deflections: `points`, or `pose` for the rigid displacement of three or more points.
        near: (n,) a solution for nearly the same readings, to begin with; None: the first guess.
        converged: Of the largest compliance: a step below it is the last.

    Raises:
        EquilibriumError: The load is beyond what these compliances carry.
        IdentificationError: `pose` without three points.
    """
    compliance = start if near is None else near
    solution = stepped(_normal(problem, compliance, deflections), compliance, start)
    for _ in range(ITERATIONS):
        change = float(np.abs(solution.value - compliance).max())
        compliance = solution.value
        if change <= converged * max(float(np.abs(compliance).max()), 1e-30):
            break
        solution = stepped(_normal(problem, compliance, deflections), compliance, start)
    normal = _normal(problem, compliance, deflections)
    freedom = int(normal.freedom.sum()) - int(solution.determined.sum())
    return LoadedFit(compliance, solution, normal, float(normal.chi2.sum()), freedom)


def stepped(normal: Normal, compliance: Float1D, start: Float1D) -> Solution:
    """Return the best compliances where the problem is linear about some, (n,) rad/(N*m).

    Args:
        normal: Normal equations there.
        compliance: (n,) about which they are.
        start: (n,) values of what the readings do not determine.
    """
    matrix, vector = normal.matrix.sum(axis=0), normal.vector.sum(axis=0)
    return solve_non_negative(matrix, vector + matrix @ compliance, start)


def normal_of(problem: LoadedProblem, linear: Linearised, deflections: Deflections) -> Normal:
    """Return the normal equations of readings, or of the poses that these make, about some compliances.

    Raises:
        IdentificationError: `pose` without three points.
    """
    if deflections == "pose":
        return normal_equations(*as_poses(problem, linear))
    return normal_equations(linear.rows, linear.residual, linear.columns)


def _normal(problem: LoadedProblem, compliance: Float1D, deflections: Deflections) -> Normal:
    return normal_of(problem, problem.linearise(compliance), deflections)


LEAVE_ONE_OUT = 200  # above this many configurations they are left out in groups
GROUPS = 20


def held_out_compliance(fit: LoadedFit, configuration: Int1D) -> Float2D:
    """Return, per configuration, the compliances fitted without it, (k, n) rad/(N*m).

    One Gauss-Newton step from the complete fit; the problem is linear up to K_CSM (a few tenths of a percent of the
    deflection), so the step lands on the fit of the rest to well below the noise.  Beyond 200 configurations they are
    left out in 20 interleaved groups.

    Args:
        fit: The complete fit.
        configuration: (m,) index of the configuration of every reading.
    """
    normal = fit.normal
    k = max(len(normal.matrix), int(configuration.max()) + 1)
    matrix, vector = normal.matrix.sum(axis=0), normal.vector.sum(axis=0)
    result = np.tile(fit.compliance, (k, 1))
    groups = np.arange(len(normal.matrix))
    if len(groups) > LEAVE_ONE_OUT:
        groups = groups % GROUPS
    for group in np.unique(groups):
        members = groups == group
        rest = matrix - normal.matrix[members].sum(axis=0)
        right = vector - normal.vector[members].sum(axis=0)
        solution = solve_non_negative(rest, right + rest @ fit.compliance, fit.compliance)
        result[np.flatnonzero(members)] = solution.value
    return result


# --- readings that do not belong --------------------------------------------------------------------------------------


SPOILT = 0.01  # of the worst squared error: what is smaller is judged once that one spoils the fit no longer
Key = tuple[int, int, str]


@dataclasses.dataclass(frozen=True, eq=False)
class OutlierRejection:
    """A fit and the readings it rests on.

    Attributes:
        fit: The fit of the readings used.
        used: (m,) mask.
        exclusions: What was not used, and why.
    """

    fit: LoadedFit
    used: Bool1D
    exclusions: tuple[Exclusion, ...]


def reject_outliers(
    problem: LoadedProblem,
    start: Float1D,
    *,
    robust: bool = True,
    readmit: frozenset[Key] = frozenset(),
    near: Float1D | None = None,
    converged: float = CONVERGED,
) -> OutlierRejection:
    """Fit the compliances and set gross errors aside.

    A reading is predicted from the other readings of its configuration and the model; its squared error in units of
    its covariance is compared with the quantile that a clean recording exceeds anywhere with 1 % probability.  The
    scale is the recording's own (median), never below the claimed noise, so that missing physics or understated noise
    does not turn readings into outliers.  Excluded readings are tested again against the final fit.

    Args:
        problem: All readings.
        start: (n,) first guess of the compliances.
        robust: False uses every reading.
        readmit: (configuration, step, point) of readings that must be used whatever they look like; the others are
            judged without them, so that a wrong one sets no sound one aside.
        near: (n,) compliances of nearly the same problem, to begin with; None: the first guess.
        converged: Of the largest compliance: a step below it is the last of the fit that is returned.
    """
    m = len(problem.readings)
    readmitted = np.array([key in readmit for key in keys_of(problem.readings)])
    used = ~readmitted
    if not robust or not used.any():
        return OutlierRejection(fit_compliance(problem, start, near=near, converged=converged), used | True, ())
    fitted = _shows(problem, used, start, near)
    exclusions: dict[int, Exclusion] = {}
    budget = max(1, int(MOST_EXCLUDED * m))
    while len(exclusions) < budget:  # until nothing is left to set aside under the compliances of those that are left
        linear, compliance, before = problem.linearise(fitted), fitted, len(exclusions)
        index = np.flatnonzero(used)
        rows = linear.rows.select(index)
        while len(exclusions) < budget:  # about one linearisation: a few readings less change the compliances little
            squared, error, _ = deleted(rows, linear.residual[index])
            size, threshold = np.linalg.norm(error, axis=1), deletion_limit(squared, m)
            worst = worst_of_each(squared, threshold, problem.configuration[index], problem.readings.step[index])
            if not len(worst):
                break
            worst = worst[squared[worst] > SPOILT * squared[worst[0]]][: budget - len(exclusions)]
            for row in worst:
                exclusions[int(index[row])] = _exclusion(problem, int(index[row]), size[row], squared[row], threshold)
                used[index[row]] = False
            rows, index = rows.without(worst), np.flatnonzero(used)
            normal = normal_equations(rows, linear.residual[index], linear.columns[index])
            change = stepped(normal, compliance, start).value - compliance
            linear = dataclasses.replace(linear, residual=linear.residual - linear.columns @ change)
            compliance = compliance + change
        if len(exclusions) == before:
            break
        fitted = _shows(problem, used, start, compliance)
    if not exclusions:
        return OutlierRejection(fit_compliance(problem, start, near=fitted, converged=converged), used | readmitted, ())
    linear = problem.linearise(fitted)
    squared = np.zeros(m)
    index = np.flatnonzero(used)
    squared[index] = deleted(linear.rows.select(index), linear.residual[index])[0]
    for row in list(exclusions):  # a reading is judged by those of its own configuration alone
        beside = np.flatnonzero(used & (problem.configuration == problem.configuration[row]))
        near_it = np.sort(np.append(beside, row))
        trial = squared.copy()
        trial[near_it] = deleted(linear.rows.select(near_it), linear.residual[near_it])[0]
        if trial[row] < TAKEN_BACK * deletion_limit(trial, m):
            used[row] = True
            squared = trial
            del exclusions[row]
    used |= readmitted
    some = problem.select(np.flatnonzero(used))
    fit = fit_compliance(some, start, near=fitted, converged=converged)
    return OutlierRejection(fit, used, tuple(exclusions[row] for row in sorted(exclusions)))


def _shows(problem: LoadedProblem, used: Bool1D, start: Float1D, near: Float1D | None) -> Float1D:
    """Return compliances under which gross errors show: of a fit, unless these ask for a robot too soft to stand."""
    some = problem if used.all() else problem.select(np.flatnonzero(used))
    try:
        fitted = fit_compliance(some, start, near=near, converged=NEARLY).compliance
        problem.linearise(fitted)  # readings that were not fitted have to stand, too
    except EquilibriumError:
        return start
    return fitted


def worst_of_each(squared: Float1D, threshold: float, group: Int1D, step: Int1D) -> Int1D:
    """Return the worst suspicious reading of every group, worst first; of two equal ones the later step.

    Args:
        squared: (m,) squared deletion residuals of the readings.
        threshold: Those above it are suspicious.
        group: (m,) or (m, k) which readings judge each other.
        step: (m,) their steps; where a group has two, each is as far from the other, and the loaded one is named.
    """
    suspects = np.flatnonzero(squared > threshold)
    order = suspects[np.lexsort((-step[suspects], -np.round(squared[suspects] / threshold, 9)))]
    _, first = np.unique(group[order], axis=0, return_index=True)
    return order[np.sort(first)]


def _exclusion(problem: LoadedProblem, row: int, size: float, squared: float, threshold: float) -> Exclusion:
    reason = (
        f"{size * 1e3:.3f} mm from where the other readings of its configuration and the model put it "
        f"({np.sqrt(squared):.1f} claimed standard deviations, limit {np.sqrt(threshold):.1f})"
    )
    return exclusion(problem.readings, row, reason, size, squared)


def keys_of(r: Readings) -> list[Key]:
    """Return (configuration, step, point) of every reading."""
    return [(int(c), int(s), r.points[p]) for c, s, p in zip(r.configuration, r.step, r.point, strict=True)]
