"""Readings that do not belong: found one at a time, named, and taken back when they fit after all."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.errors import EquilibriumError
from calibration_core.identification.checks.exclusion_anomalies import exclusion
from calibration_core.identification.result.estimate import Exclusion
from calibration_core.identification.statistics.offsets import deleted, deletion_limit, normal_equations
from calibration_core.identification.stiffness.fit import CONVERGED, NEARLY, LoadedFit, fit_compliance, stepped
from calibration_core.identification.stiffness.problem import LoadedProblem
from calibration_core.timeseries import Bool1D, Float1D, Int1D, Readings

MAX_SHARE = 0.05  # never more than this share of the readings
SPOILT = 0.01  # of the worst squared error: what is smaller is judged once that one spoils the fit no longer
RETURN = 0.5  # an excluded reading is taken back below this share of the threshold
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
        readmit: (configuration, step, point) of readings that must be used whatever they look like; the other readings
            of the same configuration and point are then not judged either.
        near: (n,) compliances of nearly the same problem, to begin with; None: the first guess.
        converged: Of the largest compliance: a step below it is the last of the fit that is returned.
    """
    m = len(problem.readings)
    used = np.ones(m, dtype=bool)
    if not robust:
        return OutlierRejection(fit_compliance(problem, start, near=near, converged=converged), used, ())
    fitted = _shows(problem, start, near)
    groups = {(configuration, point) for configuration, _, point in readmit}  # a reading judges its neighbours too
    kept = np.array([(configuration, point) in groups for configuration, _, point in keys_of(problem.readings)])
    exclusions: dict[int, Exclusion] = {}
    budget = max(1, int(MAX_SHARE * m))
    while len(exclusions) < budget:  # until nothing is left to set aside under the compliances of those that are left
        linear, compliance, before = problem.linearise(fitted), fitted, len(exclusions)
        index = np.flatnonzero(used)
        rows = linear.rows.select(index)
        while len(exclusions) < budget:  # about one linearisation: a few readings less change the compliances little
            squared, error, _ = deleted(rows, linear.residual[index])
            size, threshold = np.linalg.norm(error, axis=1), deletion_limit(squared, m)
            squared[kept[index]] = 0.0
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
        fitted = _shows(problem.select(np.flatnonzero(used)), start, compliance)
    if not exclusions:
        return OutlierRejection(fit_compliance(problem, start, near=fitted, converged=converged), used, ())
    linear = problem.linearise(fitted)
    squared = np.zeros(m)
    index = np.flatnonzero(used)
    squared[index] = deleted(linear.rows.select(index), linear.residual[index])[0]
    for row in list(exclusions):  # a reading is judged by those of its own configuration alone
        beside = np.flatnonzero(used & (problem.configuration == problem.configuration[row]))
        near_it = np.sort(np.append(beside, row))
        trial = squared.copy()
        trial[near_it] = deleted(linear.rows.select(near_it), linear.residual[near_it])[0]
        if trial[row] < RETURN * deletion_limit(trial, m):
            used[row] = True
            squared = trial
            del exclusions[row]
    some = problem.select(np.flatnonzero(used))
    fit = fit_compliance(some, start, near=fitted, converged=converged)
    return OutlierRejection(fit, used, tuple(exclusions[row] for row in sorted(exclusions)))


def _shows(problem: LoadedProblem, start: Float1D, near: Float1D | None) -> Float1D:
    """Return compliances under which gross errors show: of a fit, unless these ask for a robot too soft to stand."""
    try:
        return fit_compliance(problem, start, near=near, converged=NEARLY).compliance
    except EquilibriumError:
        return start


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
