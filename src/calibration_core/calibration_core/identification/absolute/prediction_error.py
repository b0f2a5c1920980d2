"""Held-out prediction errors by whole configurations, and when an improvement counts.

Leaving out single rows would let a configuration predict itself; whole configurations are left out (five folds, drawn
once and for all by a fixed seed, or one at a time when there are few).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.errors import EquilibriumError
from calibration_core.identification.geometry.fit import (
    AbsoluteProblem,
    GeometryFit,
    NormalEquations,
    bounded_step,
    fit,
    linearised,
    lower_steps,
    moved,
    normal_equations,
    weighed,
)
from calibration_core.identification.geometry.terms import Term, names_of
from calibration_core.identification.statistics import student_quantile
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Bool1D, Float2D, Int1D, in_time

FOLDS = 5
FEW = 30  # configurations below which every one is left out on its own
SEED = 17384
SIGNS = 3.0  # standard deviations of the number of configurations that gain by chance
CHANCE = 0.023  # probability of a clear gain where there is none: two standard errors of many configurations


def folds(configuration: Int1D) -> Int1D:
    """Return the fold of every reading, (m,), 0 first; readings of one configuration are never parted."""
    index = in_time(configuration)
    count = int(index.max(initial=-1)) + 1
    order = np.arange(count) if count < FEW else np.random.default_rng(SEED).permutation(count) % FOLDS
    return order[index].astype(np.int64)


@dataclasses.dataclass(frozen=True)
class Improvement:
    """Paired comparison of two models on held-out configurations.

    Attributes:
        gain: Mean over configurations of the squared error before minus after, m^2.
        error: Standard error of `gain`, m^2.
        before: Root mean square of the 3-d error before, m.
        after: The same after, m.
        configurations: On how many configurations it rests.
        better: In how many of them the error is smaller.
    """

    gain: float
    error: float
    before: float
    after: float
    configurations: int
    better: int

    @property
    def clear(self) -> bool:
        """Whether the gain is larger than twice its standard error (more with few configurations: Student's t).

        A smaller held-out error alone is no reason to believe a larger model: between two equally good models one is
        always smaller.  The errors of both models on one configuration go together, so their difference is judged,
        pair by pair; folds share training data, which makes the standard error a little small, hence two of them
        and not one.
        """
        if self.configurations < 2:
            return False
        return self.gain > student_quantile(1 - CHANCE, self.configurations - 1) * self.error

    @property
    def general(self) -> bool:
        """Whether far more configurations gain than chance gives (sign test), and they gain on the whole.

        A few configurations that gain far more than the others make a gain of all of them doubtful to `clear`.
        """
        count = self.configurations
        return self.gain > 0 and self.better > count / 2 + SIGNS * np.sqrt(count) / 2

    @property
    def text(self) -> str:
        """The figures in words."""
        ratio = self.gain / self.error if self.error > 0 else (np.inf if self.gain > 0 else 0.0)
        return (
            f"3-d rms of configurations left out from {1e3 * self.before:.4f} to {1e3 * self.after:.4f} mm, "
            f"paired gain {ratio:.1f} standard errors"
        )


def compare(before: Float2D, after: Float2D, configuration: Int1D) -> Improvement:
    """Compare two (3, m) arrays of held-out residuals, m, configuration by configuration."""
    squares = np.stack([np.sum(before**2, axis=0), np.sum(after**2, axis=0)])
    _, index = np.unique(configuration, return_inverse=True)
    index = index.reshape(-1)
    difference = np.bincount(index, squares[0] - squares[1]) / np.bincount(index)
    error = float(np.std(difference, ddof=1) / np.sqrt(len(difference))) if len(difference) > 1 else np.inf
    rms = np.sqrt(squares.mean(axis=1))
    better = int(np.count_nonzero(difference > 0))
    return Improvement(float(difference.mean()), error, float(rms[0]), float(rms[1]), len(difference), better)


def held_out(problem: AbsoluteProblem, whole: GeometryFit, fold: Int1D, used: Bool1D) -> Float2D:
    """Return the (3, m) residuals, m, base axes, of every reading predicted by a fit to the other folds.

    The fold's normal matrix is taken out of the total, which gives its solution to first order; one more Gauss-Newton
    step on the training data, linearised there, makes it exact for all purposes.

    Args:
        problem: All readings.
        whole: The fit to all readings used.
        fold: (m,) fold of every reading.
        used: (m,) mask of the readings that may serve for fitting; the others are only predicted.
    """
    if not whole.names:
        return problem.residual(whole.parameters)
    problem = problem.near(whole.parameters)
    linear = _Folds(problem, whole.parameters, whole.terms, fold, used)
    total = linear.total if whole.prior is None else linear.total + whole.prior.normal(whole.parameters)
    residual = np.empty((3, len(problem)))
    for k, (rows, part) in enumerate(zip(linear.rows, linear.parts, strict=True)):
        training = problem.select(np.flatnonzero(used & (fold != k)))
        residual[:, rows] = problem.select(rows).residual(_without(training, whole, total - part))
    return residual


def _without(training: AbsoluteProblem, whole: GeometryFit, normal: NormalEquations) -> ModelParameters:
    """Return the solution for the training data, whose normal equations at the whole solution are `normal`."""
    step = bounded_step(normal, lower_steps(whole.terms, whole.parameters))
    first = moved(whole.parameters, whole.terms, step)
    try:
        again = normal_equations(training, first, whole.terms)
    except EquilibriumError:  # far from linear: these compliances do not even carry the robot
        return fit(training, whole.parameters, whole.terms, whole.prior).parameters
    again = again if whole.prior is None else again + whole.prior.normal(first)
    return moved(first, whole.terms, bounded_step(again, lower_steps(whole.terms, first)))


class _Folds:
    """All readings linearised once, and the normal equations of every fold.

    Attributes:
        rows: Readings of every fold.
        columns: (p, 3, m) m per unit.
        residual: (3, m) m.
        parts: Normal equations of the readings used of every fold.
        total: Their sum.
    """

    def __init__(
        self, problem: AbsoluteProblem, parameters: ModelParameters, terms: Sequence[Term], fold: Int1D, used: Bool1D
    ) -> None:
        """Linearise; memory is 24 bytes per reading and column, twice that while the noise differs."""
        p = len(names_of(terms))
        self.rows = [np.flatnonzero(fold == k) for k in range(int(fold.max()) + 1)]
        self.columns, self.residual = np.empty((p, 3, len(problem))), np.empty((3, len(problem)))
        columns, residual = self.columns, self.residual
        weight = 1.0
        if isinstance(problem.whitening, float):
            weight = problem.whitening**2
        else:
            columns, residual = np.empty_like(columns), np.empty_like(residual)
        first = 0
        for block in problem.blocks():
            at = slice(first, first + len(block))
            self.columns[:, :, at], self.residual[:, at] = found = linearised(block, parameters, terms)
            columns[:, :, at], residual[:, at] = weighed(block, parameters, *found)
            first += len(block)
        self.parts = []
        for rows in self.rows:
            seen = rows[used[rows]]
            flat, rest = columns[:, :, seen].reshape(p, -1), residual[:, seen].reshape(-1)
            matrix, gradient = weight * (flat @ flat.T), weight * (flat @ rest)
            self.parts.append(NormalEquations(matrix, gradient, weight * float(rest @ rest), len(seen)))
        self.total = _sum(self.parts)


class LinearModel:
    """All columns of many terms at one set of parameters, for comparing models that use some of them.

    Held-out residuals of any choice of columns then cost one small solution per fold.

    Attributes:
        names: Names of the columns.
        lower: (p,) lowest step of each column.
        matrix: (p, p) normal matrix over all folds.
    """

    def __init__(
        self, problem: AbsoluteProblem, parameters: ModelParameters, terms: Sequence[Term], fold: Int1D
    ) -> None:
        """Linearise, as `_Folds`."""
        self.names = names_of(terms)
        self.lower = lower_steps(terms, parameters)
        self._linear = _Folds(problem, parameters, terms, fold, np.ones(len(problem), dtype=bool))
        self.matrix = self._linear.total.matrix

    def fitted(self, chosen: Sequence[int]) -> Float2D:
        """Return the (3, m) residuals, m, of the model with the chosen columns fitted to all readings."""
        index = np.array(chosen, dtype=int)
        step = bounded_step(self._linear.total.of(index), self.lower[index])
        return np.asarray(self._linear.residual - np.tensordot(step, self._linear.columns[index], axes=1))

    def held_out(self, chosen: Sequence[int]) -> Float2D:
        """Return the (3, m) held-out residuals, m, of the model with the chosen columns."""
        index, linear = np.array(chosen, dtype=int), self._linear
        columns, residual = linear.columns[index], np.empty_like(linear.residual)
        for rows, part in zip(linear.rows, linear.parts, strict=True):
            step = bounded_step((linear.total - part).of(index), self.lower[index])
            residual[:, rows] = linear.residual[:, rows] - np.tensordot(step, columns[:, :, rows], axes=1)
        return residual


def _sum(parts: list[NormalEquations]) -> NormalEquations:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total
