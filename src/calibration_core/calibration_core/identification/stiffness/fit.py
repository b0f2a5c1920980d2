"""Gauss-Newton on the compliances of a loaded recording, offsets eliminated."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from calibration_core.identification.statistics.offsets import Normal, normal_equations
from calibration_core.identification.statistics.solve import Solution, solve_non_negative
from calibration_core.identification.stiffness.poses import as_poses
from calibration_core.identification.stiffness.problem import Linearised, LoadedProblem
from calibration_core.timeseries import Float1D, Float2D, Int1D

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
