"""The extended model of an absolute recording: frames, geometry and effects together, on all readings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.absolute_design import absolute_state, null_columns, unweighted, weighted
from calibration_core.diagnosis.blocks import Blocks
from calibration_core.diagnosis.known_stiffness import Considered
from calibration_core.diagnosis.left_out import left_out
from calibration_core.identification.geometry import AbsoluteProblem, moved
from calibration_core.identification.terms import Term, names_of
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Readings

ROUNDS = 5
CONVERGED = 1e-8  # m and rad
TINY = 1e-9  # of columns of length one: directions below it stay as they are
NOTHING_KNOWN = Considered()


@dataclasses.dataclass(frozen=True, eq=False)
class AbsoluteExtended:
    """The extended model and what it leaves.

    Attributes:
        problem: All readings.
        used: (m,) readings that were fitted.
        state: What the effects depend on, at the final parameters.
        parameters: Frames, geometry, compliances.
        candidates: The effects in the model.
        value: (p,) their parameters.
        covariance: (p, p), from the scatter of whole blocks in time, and from compliances that are held.
        columns: (3 m, n + p) weighted columns of length one, for leaving out blocks.
        rest: (3 m,) weighted residual.
    """

    problem: AbsoluteProblem
    used: Bool1D
    state: State
    parameters: ModelParameters
    candidates: tuple[Candidate, ...]
    value: Float1D
    covariance: Float2D
    columns: Float2D
    rest: Float1D

    @property
    def residual(self) -> Float2D:
        """(m, 3) m, measured minus predicted, base axes."""
        return unweighted(self.problem, self.parameters, self.rest)

    def held_out(self, partition: Blocks) -> Float2D:
        """Return (m, 3) m: the residual of every reading when its block is left out of the fit."""
        values = left_out(self.columns, self.rest, partition, self.used)
        return unweighted(self.problem, self.parameters, values)

    def values_of(self, index: int) -> tuple[Float1D, Float2D]:
        """Return the parameters of one effect, (k,), and their covariance, (k, k)."""
        start = sum(len(candidate.parameters) for candidate in self.candidates[:index])
        block = slice(start, start + len(self.candidates[index].parameters))
        return self.value[block], self.covariance[block, block]

    def shift(self, state: State, chosen: Sequence[int] | None = None) -> Float2D:
        """Return the (m, 3) m that the effects (all, or those of the given positions) move the points of any state."""
        total = np.zeros((state.m, 3))
        for index in range(len(self.candidates)) if chosen is None else chosen:
            total += self.candidates[index].columns(state) @ self.values_of(index)[0]
        return total


def extend_absolute(
    problem: AbsoluteProblem,
    used: Bool1D,
    parameters: ModelParameters,
    terms: Sequence[Term],
    candidates: Sequence[Candidate],
    readings: Readings,
    cell: Cell,
    partition: Blocks,
    nuisances: Sequence[Candidate] = (),
    considered: Considered = NOTHING_KNOWN,
) -> AbsoluteExtended:
    """Fit terms and effects together, linearised again until nothing moves.

    Args:
        problem: All readings.
        used: (m,) readings that may be fitted.
        parameters: Start, the null model.
        terms: Frames and geometry.
        candidates: The effects.
        readings: The recording.
        cell: The cell file.
        partition: Blocks for the covariance.
        nuisances: Compliances that belong to the null model (`joint_elasticity` of joints); they move `parameters`.
        considered: Compliances that are held, whose covariance enters that of the effects, and what is known of the
            nuisances.
    """
    value = np.zeros(sum(len(candidate.parameters) for candidate in candidates))
    n = len(names_of(terms))
    fitted = np.repeat(used, 3)
    rounds = 0
    while True:
        rounds += 1
        state = absolute_state(problem, parameters, readings, cell)
        null, residual = null_columns(problem, parameters, terms)
        extra = [weighted(problem, parameters, candidate.columns(state)) for candidate in (*nuisances, *candidates)]
        wide = np.concatenate([null, *extra], axis=1)
        own = wide[:, wide.shape[1] - len(value) :]
        length = np.linalg.norm(wide[fitted], axis=0)
        length = np.where(length > 0, length, 1.0)
        wide = wide / length
        rest = residual - own @ value
        prior, lacking = _prior(considered, nuisances, parameters, n, length)
        matrix, right = np.vstack([wide[fitted], prior]), np.concatenate([rest[fitted], lacking])
        change = np.linalg.lstsq(matrix, right, rcond=TINY)[0] / length
        if rounds == ROUNDS or np.abs(change[:n]).max(initial=0.0) < CONVERGED:
            break
        value = value + change[len(change) - len(value) :]
        parameters = _softened(moved(parameters, terms, change[:n]), nuisances, change[n : n + len(nuisances)])
    covariance = sandwich(wide[fitted], rest[fitted], partition.of(np.flatnonzero(used)), prior)
    if considered.candidates:
        held = [weighted(problem, parameters, candidate.columns(state))[fitted] for candidate in considered.candidates]
        silent = np.zeros((len(prior), len(considered.candidates)))
        answer = np.linalg.lstsq(matrix, np.vstack([np.concatenate(held, axis=1), silent]), rcond=TINY)[0]
        covariance = covariance + answer @ considered.covariance @ answer.T
    covariance = covariance / np.outer(length, length)
    tail = slice(len(length) - len(value), len(length))
    return AbsoluteExtended(
        problem, used, state, parameters, tuple(candidates), value, covariance[tail, tail], wide, rest
    )


def _softened(parameters: ModelParameters, nuisances: Sequence[Candidate], change: Float1D) -> ModelParameters:
    """Apply changes of compliances, which do not become negative."""
    compliance = parameters.compliance.copy()
    for nuisance, more in zip(nuisances, change, strict=True):
        joint = parameters.joints.index(str(nuisance.location["joint"]))
        compliance[joint] = max(compliance[joint] + more, 0.0)
    return parameters.replace(compliance=compliance)


def _prior(
    considered: Considered, nuisances: Sequence[Candidate], parameters: ModelParameters, n: int, length: Float1D
) -> tuple[Float2D, Float1D]:
    """Return rows that hold what is known of nuisances, (f, columns) scaled by `length`, and what they lack, (f,)."""
    rows = np.zeros((len(considered.expected), len(length)))
    if not len(rows):
        return rows, np.zeros(0)
    rows[:, n : n + len(nuisances)] = considered.root
    now = parameters.compliance[[parameters.joints.index(str(one.location["joint"])) for one in nuisances]]
    return rows / length, considered.root @ (considered.expected - now)


def sandwich(columns: Float2D, rest: Float1D, partition: Blocks, prior: Float2D | None = None) -> Float2D:
    """Return the covariance of least squares from the scatter of blocks (Liang and Zeger 1986).

    Args:
        columns: (r, p) weighted.
        rest: (r,) residual.
        partition: Into blocks.
        prior: (f, p) rows of a prior, each of standard deviation one.
    """
    known = np.zeros((len(columns.T), len(columns.T))) if prior is None else prior.T @ prior
    inverse = np.linalg.pinv(columns.T @ columns + known, rcond=TINY, hermitian=True)
    label = np.repeat(partition.label, 3)
    scores = np.stack([np.bincount(label, column * rest) for column in columns.T], axis=1)
    meat = scores.T @ scores * (partition.count / max(partition.count - 1, 1)) + known
    return np.asarray(inverse @ meat @ inverse, dtype=np.float64)
