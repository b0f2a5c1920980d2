"""Everything accepted, fitted together on all readings, linear about its own solution: one estimate, one covariance.

    minimise |V^(-1/2) (y - N a - A b)|^2 + v sum(b^2 / t^2)

frames and geometry a free, effects b with the prior of their size t; linearised again at the solution until nothing
moves.  The covariance is v (X'X + prior)^(-1), widened where the scatter of whole blocks asks for it.
Source: Liang and Zeger 1986 (scatter of blocks).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.linalg.lapack import dtrtri

from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.columns import Columns, rows_of_readings
from calibration_core.estimation.hypotheses import is_axial
from calibration_core.estimation.leave_out import RIDGE, left_out
from calibration_core.estimation.noise.whitening import Whitening
from calibration_core.estimation.rows import Linear, NullModel, unweighted
from calibration_core.identification.geometry.fit import moved
from calibration_core.identification.geometry.terms import names_of
from calibration_core.model.effects.applied import Acting, acting
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.possible import nearest
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D

ROUNDS = 3
SETTLING = 3  # rounds
STEP = 2.0  # factor by which a compliance may move in one round
APART = 20.0  # factor between a compliance and what was believed of it
CONVERGED = 1e-6  # m and rad
STILL = 0.01  # of a compliance
FAR = 0.1  # of a compliance and, in
SURE = 1.0  # standard deviations, of it: what would still move by more than both is fitted in more rounds,
MOST_ROUNDS = 8  # at most


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """One candidate in the model.

    Attributes:
        size: Standard deviation of its parameters' prior, typical sizes.
    """

    candidate: Candidate
    size: float

    @property
    def prior(self) -> Float1D:
        """(k,) standard deviations in the parameters' units."""
        return self.size * np.array([parameter.typical for parameter in self.candidate.parameters])


@dataclasses.dataclass(frozen=True, eq=False)
class Extended:
    """The extended model and what it leaves.

    Attributes:
        model: Frames, geometry and compliances at the solution.
        parts: The effects in the model.
        value: (p,) their parameters.
        held: (p,) which of it the model's compliances hold already: sag acts on the deformed robot.
        covariance: (f + p, f + p) of everything, units of the parameters.
        linear: Columns of everything, per unit of the parameters.
        length: (f + p,) lengths of the columns as independent rows of the readings used.
        residual: (3 m,) at the solution, in units of the claimed noise.
        gram: (f + p, f + p) products of the columns, as independent rows of the readings used, of length one.
        rest: (3 m,) the residual as independent rows.
        ridge: (f + p,) precision of the priors times the variance, of columns of length one.
        variance: Of an independent row.
        fixed: (h, f + p) combinations of the parameters that physics holds at zero.
    """

    model: NullModel
    whitening: Whitening
    parts: tuple[Part, ...]
    value: Float1D
    held: Float1D
    covariance: Float2D
    linear: Linear
    length: Float1D
    residual: Float1D
    gram: Float2D
    rest: Float1D
    ridge: Float1D
    variance: float
    fixed: Float2D

    @property
    def parameters(self) -> ModelParameters:
        """Frames, geometry, compliances."""
        return self.model.parameters

    @property
    def flat(self) -> int:
        """Number of columns of the null model."""
        return len(self.length) - len(self.value)

    @property
    def left(self) -> Float2D:
        """(m, 3) m, measured minus predicted, base axes; offsets of configurations with several steps taken out."""
        return self._metres(self.whitening.without_offsets(self.residual))

    def held_out(self, partition: Blocks) -> Float2D:
        """Return (m, 3) m: the same for every reading when its block is left out of the fit."""
        own, white = self.linear.own, self.linear.white
        rest = self.rest + white.effects @ self.value  # left out, an effect falls back to its prior, not to this
        whole = (self.gram + np.diag(self.ridge + RIDGE)) * np.outer(self.length, self.length)
        normal = whole, white.against(np.where(np.repeat(self.model.used, 3), rest, 0.0))
        other = None
        if own is not white:
            other = own, self.residual + own.effects @ self.value
        at = left_out(white, rest, partition, normal, self.model.used, other, self.fixed)
        return self._metres(self.whitening.without_offsets(at))

    def block(self, index: int) -> slice:
        """Return where the parameters of a part stand in `value`."""
        return slice(self._ends[index], self._ends[index + 1])

    @functools.cached_property
    def _ends(self) -> tuple[int, ...]:
        """Where the parameters of parts begin, and end: there may be hundreds of parts, and each is asked for."""
        return tuple(itertools.accumulate((len(part.candidate.parameters) for part in self.parts), initial=0))

    def values_of(self, index: int) -> tuple[Float1D, Float2D]:
        """Return the parameters of one part, (k,), and their covariance, (k, k)."""
        block = self.block(index)
        wide = slice(self.flat + block.start, self.flat + block.stop)
        return self.value[block], self.covariance[wide, wide]

    def of_part(self, index: int) -> Float1D:
        """Return the values of all parameters, (p,), zero but for those of one part."""
        return self._of([index], self.value)

    def shift(self, chosen: Sequence[int]) -> Float2D:
        """Return the (m, 3) m that some parts move the points beyond what the compliances do."""
        return self._metres(self.linear.own.effects @ self._of(chosen, self.value - self.held))

    def moved_by(self, column: int) -> Float2D:
        """Return the (m, 3) m that a parameter of the null model moves the points, per unit."""
        return self._metres(self.linear.own.flat[:, column])

    def own_shift(self, chosen: Sequence[int]) -> Float2D:
        """Return (m, 3) m: what parts move the points beyond what the null model would take up instead."""
        if not chosen:
            return np.zeros((len(self.model.readings), 3))
        own, white, value = self.linear.own, self.linear.white, self._of(chosen, self.value)
        effect = own.effects @ value
        null = white.flat / self.length[: self.flat]
        seen = null.T @ (effect if own is white else white.effects @ value)
        taken = np.linalg.solve(null.T @ null + RIDGE * np.eye(self.flat), seen) / self.length[: self.flat]
        return self._metres(self.whitening.without_offsets(effect - own.flat @ taken))

    def _of(self, chosen: Sequence[int], value: Float1D) -> Float1D:
        """Return values of all parameters, (p,), zero but for those of some parts."""
        result = np.zeros_like(value)
        for index in chosen:
            result[self.block(index)] = value[self.block(index)]
        return result

    def _metres(self, values: Float1D) -> Float2D:
        return unweighted(self.model.problem, self.parameters, values)


def refit(
    model: NullModel,
    whitening: Whitening,
    parts: Sequence[Part],
    partition: Blocks,
    *,
    known: Extended | None = None,
) -> Extended:
    """Fit null model and effects together, linearised again until nothing moves.

    Args:
        model: The null model to start from.
        whitening: Of all readings.
        parts: The effects.
        partition: Blocks of the m readings for the covariance.
        known: The same of other readings used, at the model to start from; None: not known.
    """
    held, value = _held(model, parts), np.zeros(sum(len(part.candidate.parameters) for part in parts))
    prior = np.concatenate([np.zeros(0), *(part.prior for part in parts)])
    fitted = np.repeat(model.used, 3)
    aside, count = np.flatnonzero(~model.used), int(fitted.sum())
    n = len(names_of(model.terms))
    f = n + len(model.fitted_compliances)
    linear = None if known is None else known.linear
    turn = 0
    while True:
        turn += 1
        linear = linear if linear is not None and linear.serves(model) else None  # its memory is taken again
        linear, residual = Linear.at(model, whitening, [part.candidate for part in parts], linear)
        residual = residual - linear.own.effects @ (value - held)
        rest = whitening(residual[:, None])[:, 0]
        kept = np.where(fitted, rest, 0.0)
        normal, right, square = linear.normal(aside), linear.white.against(kept), float(kept @ kept)
        length = np.sqrt(np.where(np.diag(normal) > 0, np.diag(normal), 1.0))
        normal, right = normal / np.outer(length, length), right / length
        variance = square / max(count - f, 1)
        precision = np.concatenate([np.zeros(f), 1 / (prior * length[f:]) ** 2])
        lacking = np.concatenate([np.zeros(f), value * length[f:]])
        settled = _settled(normal, right, precision, lacking, variance, (square, count))
        ridge, change, variance = settled.ridge, settled.change, settled.variance
        inverse = settled.root.T @ settled.root
        spread = variance * inverse[f:, f:] / np.outer(length[f:], length[f:])
        allowed = nearest([part.candidate.parameters for part in parts], value + change[f:] / length[f:], spread)
        if len(allowed.held):  # the effects as physics allows them, everything else the best beside them
            change = _beside(normal, right, (allowed.value - value) * length[f:])
        step = change / length
        softer = step[n:f] / np.maximum(_fitted(model), 1e-300)
        still = np.abs(step[:n]).max(initial=0.0) < CONVERGED and np.abs(softer).max(initial=0.0) < STILL
        sure = np.abs(change[n:f]) > SURE * np.sqrt(variance * np.diag(inverse)[n:f])
        far = bool(np.any(sure & (np.abs(softer) > FAR) & (_fitted(model) > 0)))
        if still or (turn >= ROUNDS and not far) or turn == MOST_ROUNDS:
            break
        value = value + step[f:]
        parameters = moved(model.parameters, model.terms, step[:n])
        parameters = _softened(parameters, model.fitted_compliances, step[n:f], model.believed)
        model = model.at(_sagging(parameters, parts, value), _springs(parts, value))
        held = _held(model, parts)
    value = allowed.value
    residual = residual - linear.own.moved(step)
    rest = residual if linear.own is linear.white else rest - linear.white.moved(step)
    kept = np.where(fitted, rest, 0.0)
    variance = float(kept @ kept) / max(count - settled.effective, 1.0)
    covariance = variance * inverse  # what nothing shows stays as unknown as the ridge lets it be
    covariance = _widened(covariance, inverse / length, linear.white, kept, partition) / np.outer(length, length)
    fixed = np.concatenate([np.zeros((len(allowed.held), f)), allowed.held], axis=1)
    return Extended(
        model, whitening, tuple(parts), value, held, covariance, linear, length, residual, normal, rest, ridge,
        variance, fixed,
    )  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class _Settled:
    """A solution and the variance of the rows that belongs to it.

    Attributes:
        ridge: (f + p,) precision of the priors times the variance before.
        root: (f + p, f + p) R with R'R the inverse of the normal matrix, priors included.
        change: (f + p,) the solution.
        effective: Number of parameters, those held by their priors counted in part.
        variance: Of a row.
    """

    ridge: Float1D
    root: Float2D
    change: Float1D
    effective: float
    variance: float


def _settled(
    normal: Float2D, right: Float1D, precision: Float1D, lacking: Float1D, variance: float, rows: tuple[float, int]
) -> _Settled:
    """Solve, and let the variance of the rows and the solution settle together.

    Args:
        normal: (f + p, f + p) of columns of length one.
        right: (f + p,).
        precision: (f + p,) of the priors.
        lacking: (f + p,) where the solution begins, in the priors' eyes.
        variance: To begin with.
        rows: Squared residual and number of the rows.
    """
    square, count = rows
    turn = 0
    while True:
        turn += 1
        ridge = variance * precision
        lower = cholesky(normal + np.diag(ridge + RIDGE), lower=True, overwrite_a=True, check_finite=False)
        change = cho_solve((lower, True), right - ridge * lacking, check_finite=False)
        root = np.asarray(dtrtri(lower, lower=True, overwrite_c=True)[0])
        effective = len(right) - float((ridge + RIDGE) @ np.einsum("ij,ij->j", root, root))
        left = square - float(change @ (2 * right - normal @ change))
        variance = max(left, 0.0) / max(count - effective, 1.0)
        if turn == SETTLING:
            return _Settled(ridge, root, change, effective, variance)


def _springs(parts: Sequence[Part], value: Float1D) -> Acting:
    """Return the parts that act on joints, with their parameters, (p,) of all parts."""
    ends = list(itertools.accumulate((len(part.candidate.parameters) for part in parts), initial=0))
    return acting([part.candidate for part in parts], [value[a:b] for a, b in itertools.pairwise(ends)])


def _beside(normal: Float2D, right: Float1D, effects: Float1D) -> Float1D:
    """Return the whole solution, (f + p,), where that of the effects, (p,), is given."""
    f = len(right) - len(effects)
    flat = np.linalg.solve(normal[:f, :f] + RIDGE * np.eye(f), right[:f] - normal[:f, f:] @ effects)
    return np.concatenate([flat, effects])


def _fitted(model: NullModel) -> Float1D:
    """Return the compliances that the null model fits, in their order."""
    joints = model.parameters.joints
    index = [joints.index(str(one.location["joint"])) for one in model.fitted_compliances]
    return np.asarray(model.parameters.compliance[index])


def _softened(
    parameters: ModelParameters, fitted: Sequence[Candidate], change: Float1D, believed: Float1D
) -> ModelParameters:
    """Apply changes of compliances, within factors of what they were and of what was believed: never 0 nor absurd."""
    compliance = parameters.compliance.copy()
    for one, more in zip(fitted, change, strict=True):
        joint = parameters.joints.index(str(one.location["joint"]))
        now, start = compliance[joint], believed[joint]
        least, most = max(now / STEP, start / APART), min(STEP * now, APART * start) if start > 0 else np.inf
        compliance[joint] = np.clip(now + more, least, most)
    return parameters.replace(compliance=compliance)


def _held(model: NullModel, parts: Sequence[Part]) -> Float1D:
    """Return which of the parts' values the model's compliances hold, (p,)."""
    held = []
    for part in parts:
        several = np.zeros(len(part.candidate.parameters))
        if is_axial(part.candidate):
            several[0] = model.parameters.compliance[
                model.parameters.joints.index(str(part.candidate.location["joint"]))
            ]
        held.append(several)
    return np.concatenate([np.zeros(0), *held])


def _sagging(parameters: ModelParameters, parts: Sequence[Part], value: Float1D) -> ModelParameters:
    """Put compliances that were found into the model, so that the robot's weight acts on its deformed shape."""
    compliance, at = parameters.compliance.copy(), 0
    for part in parts:
        if is_axial(part.candidate):
            compliance[parameters.joints.index(str(part.candidate.location["joint"]))] = max(float(value[at]), 0.0)
        at += len(part.candidate.parameters)
    return parameters.replace(compliance=compliance)


def _widened(covariance: Float2D, inverse: Float2D, columns: Columns, rest: Float1D, partition: Blocks) -> Float2D:
    """Return the covariance with every standard deviation at least what the scatter of blocks shows.

    Args:
        covariance: (p, p) of the solution, in lengths of the columns.
        inverse: (p, p) of its normal matrix, over the columns' lengths.
        columns: Of the m readings.
        rest: (3 m,) what is left; 0 where it was not fitted.
        partition: Blocks of the m readings.
    """
    parts = ((rows, rows_of_readings(rest, rows)) for rows in map(partition.readings, range(partition.count)))
    blocks = [columns.rows(rows).against(left) for rows, left in parts if np.any(left)]
    scores = np.stack(blocks) @ inverse.T
    seen = np.einsum("bi,bi->i", scores, scores) * (len(blocks) / max(len(blocks) - 1, 1))
    more = np.sqrt(np.maximum(seen / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return np.asarray(covariance * np.outer(more, more))
