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
from scipy.linalg import null_space

from calibration_core.estimation.blocks import STAYS, Blocks
from calibration_core.estimation.hypotheses import is_axial
from calibration_core.estimation.leave_out import RIDGE, left_out
from calibration_core.estimation.noise.whitening import Whitening
from calibration_core.estimation.rows import NullModel, unweighted
from calibration_core.identification.geometry.fit import moved
from calibration_core.identification.geometry.terms import names_of
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.possible import nearest
from calibration_core.model.effects.state import State
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D, Int1D

ROUNDS = 3
SETTLING = 3  # rounds
STEP = 2.0  # factor by which a compliance may move in one round
APART = 4.0  # factor between a compliance and what was believed of it
CONVERGED = 1e-6  # m and rad
STILL = 0.01  # of a compliance
STAY = 1e-3  # of a compliance: by which it may move before columns of effects are written anew


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """One candidate in the model.

    Attributes:
        candidate: What it is.
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
        whitening: Of all readings.
        parts: The effects in the model.
        value: (p,) their parameters.
        held: (p,) which of it the model's compliances hold already: sag acts on the deformed robot.
        covariance: (f + p, f + p) of everything, units of the parameters.
        own: (3 m, f + p) columns in units of the claimed noise, of length one.
        residual: (3 m,) likewise, at the solution.
        columns: (3 m, f + p) the same as independent rows.
        gram: (f + p, f + p) products of those of the readings used.
        rest: (3 m,) the residual as independent rows.
        ridge: (f + p,) precision of the priors times the variance.
        variance: Of an independent row.
        free: (f + p, k) directions in which physics lets the solution move, in lengths of the columns; None: in all.
    """

    model: NullModel
    whitening: Whitening
    parts: tuple[Part, ...]
    value: Float1D
    held: Float1D
    covariance: Float2D
    own: Float2D
    residual: Float1D
    columns: Float2D
    gram: Float2D
    rest: Float1D
    ridge: Float1D
    variance: float
    free: Float2D | None

    @property
    def parameters(self) -> ModelParameters:
        """Frames, geometry, compliances."""
        return self.model.parameters

    @property
    def flat(self) -> int:
        """Number of columns of the null model."""
        return self.own.shape[1] - len(self.value)

    @property
    def left(self) -> Float2D:
        """(m, 3) m, measured minus predicted, base axes; offsets of configurations with several steps taken out."""
        return self._metres(self.whitening.without_offsets(self.residual))

    def held_out(self, partition: Blocks) -> Float2D:
        """Return (m, 3) m: the same for every reading when its block is left out of the fit."""
        mean = self.value * self._length[self.flat :]  # left out, an effect falls back to its prior, not to this
        rest, residual = (one + wide[:, self.flat :] @ mean for one, wide in self._both)
        columns, own, ridge = self.columns, self.own, np.diag(self.ridge)
        if self.free is not None:
            columns, own, ridge = columns @ self.free, own @ self.free, self.free.T @ ridge @ self.free
        at = left_out(columns, rest, partition, ridge, self.model.used, own=(own, residual))
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

    def shift(self, state: State, chosen: Sequence[int]) -> Float2D:
        """Return the (m, 3) m that some parts move the points of any state beyond what the compliances do."""
        total = np.zeros((state.m, 3))
        for index in chosen:
            block = self.block(index)
            total += self.parts[index].candidate.columns(state) @ (self.value[block] - self.held[block])
        return total

    def own_shift(self, chosen: Sequence[int]) -> Float2D:
        """Return (m, 3) m: what parts move the points beyond what the null model would take up instead."""
        if not chosen:
            return np.zeros((len(self.model.readings), 3))
        index = np.concatenate([np.arange(self.block(i).start, self.block(i).stop) for i in chosen])
        moved_own = self.own[:, self.flat + index] @ (self.value[index] * self._length[self.flat + index])
        null = self.columns[:, : self.flat]
        white = self.columns[:, self.flat + index] @ (self.value[index] * self._length[self.flat + index])
        normal = null.T @ null + RIDGE * np.eye(self.flat)
        taken = np.linalg.solve(normal, null.T @ white)
        return self._metres(self.whitening.without_offsets(moved_own - self.own[:, : self.flat] @ taken))

    @property
    def _both(self) -> tuple[tuple[Float1D, Float2D], tuple[Float1D, Float2D]]:
        return (self.rest, self.columns), (self.residual, self.own)

    @property
    def _length(self) -> Float1D:
        return np.sqrt(self.scale)

    scale: Float1D = dataclasses.field(default_factory=lambda: np.zeros(0))

    def _metres(self, values: Float1D) -> Float2D:
        return unweighted(self.model.problem, self.parameters, values)


class _Columns:
    """Columns of everything, (3 m, f + p), at one linearisation, and their products over all readings.

    Those of the null model are written anew at every linearisation.  Those of effects stay as long as the compliances
    do: by what frames and geometry are corrected they change in the fourth digit.

    Attributes:
        own: In units of the claimed noise, per unit of the parameters.
        white: The same as independent rows; the same array where the rows are independent as they are.
        gram: (f + p, f + p) of `white`.
    """

    def __init__(self, model: NullModel, whitening: Whitening, parts: Sequence[Part], known: Extended | None) -> None:
        self._everything = np.arange(len(model.readings))
        self._whitening, self._candidates = whitening, [part.candidate for part in parts]
        if known is None:
            self._at: Float1D | None = None
            return
        self._at, length = known.model.parameters.compliance, np.sqrt(known.scale)
        self.own = known.own * length
        self.white = self.own if known.own is known.columns else known.columns * length
        aside = known.columns[_aside(known.model)]
        self.gram = (known.gram + aside.T @ aside) * np.outer(length, length)

    def at(self, model: NullModel) -> Float1D:
        """Linearise about a model, and return the residual of all rows there, (3 m,), in units of the claimed noise."""
        flat, residual = model.flat(self._everything)
        f, compliance = flat.shape[1], model.parameters.compliance
        if self._at is None or np.any(np.abs(compliance - self._at) > STAY * self._at):
            self._at = compliance
            self.own = model.moves(self._candidates, self._everything, flat)
            self.white = self._whitening(self.own)
            self.gram = self.white.T @ self.white
            return residual
        independent = self.white is self.own
        self.own[:, :f] = flat
        if not independent:
            self.white[:, :f] = self._whitening(flat)
        cross = self.white.T @ self.white[:, :f]
        self.gram[:, :f], self.gram[:f] = cross, cross.T
        return residual


def refit(
    model: NullModel,
    whitening: Whitening,
    parts: Sequence[Part],
    partition: Blocks,
    *,
    rounds: int = ROUNDS,
    known: Extended | None = None,
) -> Extended:
    """Fit null model and effects together, linearised again until nothing moves.

    Args:
        model: The null model to start from.
        whitening: Of all readings.
        parts: The effects.
        partition: Blocks of the m readings for the covariance.
        rounds: Linearisations at most.
        known: The same of other readings used, at the model to start from; None: not known.
    """
    held, value = _held(model, parts), np.zeros(sum(len(part.candidate.parameters) for part in parts))
    prior = np.concatenate([np.zeros(0), *(part.prior for part in parts)])
    fitted, aside = np.repeat(model.used, 3), _aside(model)
    n = len(names_of(model.terms))
    f = n + len(model.fitted_compliances)
    linear = _Columns(model, whitening, parts, known)
    turn = 0
    while True:
        turn += 1
        residual = linear.at(model)
        residual = residual - linear.own[:, f:] @ (value - held)
        rest = whitening(residual[:, None])[:, 0]
        unused = linear.white[aside]
        normal = linear.gram - unused.T @ unused
        right = rest @ linear.white - rest[aside] @ unused
        square = np.diag(normal)
        length = np.sqrt(np.where(square > 0, square, 1.0))
        normal, right = normal / np.outer(length, length), right / length
        variance = float(rest[fitted] @ rest[fitted]) / max(int(fitted.sum()) - f, 1)
        precision = np.concatenate([np.zeros(f), 1 / (prior * length[f:]) ** 2])
        lacking = np.concatenate([np.zeros(f), value * length[f:]])
        settling = 0
        while True:  # the variance of the rows and the solution settle together
            settling += 1
            ridge = variance * precision
            inverse = np.asarray(np.linalg.inv(normal + np.diag(ridge + RIDGE)), dtype=np.float64)
            change = inverse @ (right - ridge * lacking)
            left = rest - linear.white @ (change / length)
            effective = float(np.einsum("ij,ji->", inverse, normal))
            variance = float(left[fitted] @ left[fitted]) / max(int(fitted.sum()) - effective, 1.0)
            if settling == SETTLING:
                break
        spread = variance * inverse[f:, f:] / np.outer(length[f:], length[f:])
        allowed = nearest([part.candidate.parameters for part in parts], value + change[f:] / length[f:], spread)
        if len(allowed.held):  # the effects as physics allows them, everything else the best beside them
            change = _beside(normal, right, (allowed.value - value) * length[f:])
            left = rest - linear.white @ (change / length)
            variance = float(left[fitted] @ left[fitted]) / max(int(fitted.sum()) - effective, 1.0)
        step = change / length
        softer = step[n:f] / np.maximum(_fitted(model), 1e-300)
        still = np.abs(step[:n]).max(initial=0.0) < CONVERGED and np.abs(softer).max(initial=0.0) < STILL
        if turn == rounds or still:
            break
        value = value + step[f:]
        parameters = moved(model.parameters, model.terms, step[:n])
        parameters = _softened(parameters, model.fitted_compliances, step[n:f], model.believed)
        model = model.at(_sagging(parameters, parts, value))
        held = _held(model, parts)
    value = value + step[f:]
    own, columns = linear.own, linear.white
    residual = residual - own @ step
    columns /= length
    if own is not columns:
        own /= length
    covariance = variance * inverse @ (normal + np.diag(ridge)) @ inverse
    label = np.repeat(np.where(model.used, partition.label, STAYS), 3)
    widened = _widened(covariance, inverse, columns, left, label)
    covariance = widened / np.outer(length, length)
    return Extended(
        model, whitening, tuple(parts), value, held, covariance, own, residual, columns, normal, left, ridge, variance,
        free=_directions(allowed.held, length[f:], f), scale=length**2,
    )  # fmt: skip


def _aside(model: NullModel) -> Int1D:
    """Return the rows that are not fitted; these are few."""
    return np.flatnonzero(~np.repeat(model.used, 3))


def _beside(normal: Float2D, right: Float1D, effects: Float1D) -> Float1D:
    """Return the whole solution, (f + p,), where that of the effects, (p,), is given."""
    f = len(right) - len(effects)
    flat = np.linalg.solve(normal[:f, :f] + RIDGE * np.eye(f), right[:f] - normal[:f, f:] @ effects)
    return np.concatenate([flat, effects])


def _directions(held: Float2D, length: Float1D, flat: int) -> Float2D | None:
    """Return the directions, in lengths of the columns, in which nothing is held, (f + p, k); None: in all.

    Args:
        held: (h, p) combinations of the effects' parameters that stay zero.
        length: (p,) of their columns.
        flat: Number f of the columns before them.
    """
    if not len(held):
        return None
    fixed = np.concatenate([np.zeros((len(held), flat)), held / length], axis=1)
    return np.asarray(null_space(fixed / np.linalg.norm(fixed, axis=1, keepdims=True)), dtype=np.float64)


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


def _widened(covariance: Float2D, inverse: Float2D, columns: Float2D, rest: Float1D, label: Int1D) -> Float2D:
    """Return the covariance with every standard deviation at least what the scatter of blocks shows.

    Args:
        covariance: (p, p) of the solution.
        inverse: (p, p) of its normal matrix.
        columns: (r, p).
        rest: (r,) what is left.
        label: (r,) block of every row; `STAYS` where it was not fitted.
    """
    blocks = [np.flatnonzero(label == block) for block in np.unique(label[label != STAYS])]
    scores = np.stack([rest[rows] @ columns[rows] for rows in blocks]) @ inverse
    seen = np.einsum("bi,bi->i", scores, scores) * (len(blocks) / max(len(blocks) - 1, 1))
    more = np.sqrt(np.maximum(seen / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return np.asarray(covariance * np.outer(more, more))
