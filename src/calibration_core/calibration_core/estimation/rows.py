"""A recording as rows of one linear model: readings, null model, and movements in units of the claimed noise.

Rows are coordinates, reading after reading; columns are movements of the measured points.  Absolute positions are the
rows of every recording: a loaded reading is one more position, under another wrench.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.estimation.columns import Columns, Effects, Turns
from calibration_core.estimation.noise.whitening import Whitening
from calibration_core.identification.geometry.fit import AbsoluteProblem
from calibration_core.identification.geometry.terms import Term, columns_of
from calibration_core.model.effects.applied import Acting, with_side_torques
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State, recorded_state
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Readings, numbers_in_time

STAY = 1e-3  # of a compliance: by which it may move before columns of effects are written anew
SEARCHED = 1_000  # configurations in the sample that is searched
TOGETHER = 8  # candidates whose columns are written at once: one by one each row would be fetched as often


@dataclasses.dataclass(frozen=True, eq=False)
class NullModel:
    """A recording and the model that is fitted to it before any hypothesis.

    Attributes:
        readings: The recording, m rows in the order of time.
        problem: The same readings as positions.
        parameters: Frames, geometry and compliances, at which everything is linear.
        terms: Frames and identifiable geometry, refitted beside every hypothesis.
        fitted_compliances: Compliances of the null model, refitted likewise.
        state: What effects depend on, for all readings.
        used: (m,) readings that may be fitted.
        believed: (n,) compliances before anything was fitted here, rad/(N*m).
        springs: What was found beside joints, whose torques everything else is linear about.
    """

    readings: Readings
    cell: Cell
    problem: AbsoluteProblem
    parameters: ModelParameters
    terms: tuple[Term, ...]
    fitted_compliances: tuple[Candidate, ...]
    state: State
    used: Bool1D
    believed: Float1D
    springs: Acting = ()

    def at(self, parameters: ModelParameters, springs: Acting | None = None) -> NullModel:
        """Return the same model, linear about other parameters, and other springs beside joints (None: the same)."""
        springs = self.springs if springs is None else springs
        state = with_side_torques(state_at(self.problem, parameters, self.readings, self.cell), springs)
        return dataclasses.replace(self, parameters=parameters, state=state, springs=springs)

    @property
    def begun(self) -> NullModel:
        """The same model at the compliances that were believed, where it fits them.

        What is missing spoils the null model's compliances, sometimes beyond what a few linearisations put right.
        """
        if not self.fitted_compliances:
            return self
        return self.at(self.parameters.replace(compliance=self.believed))

    def flat(self, rows: Int1D) -> tuple[Float2D, Float1D]:
        """Return the null model's columns (3 r, f) and the residual (3 r,) of some readings, units of the claim."""
        part = self.problem.select(rows)
        columns, residual = null_columns(part, self.parameters, self.terms)
        return self.moves(self.fitted_compliances, rows, columns), residual

    def moves(
        self, candidates: Sequence[Candidate], rows: Int1D, before: Float2D | None = None, below: int = 0
    ) -> Float2D:
        """Return the columns of candidates per unit of their parameters, (3 r, k), in units of the claimed noise.

        They may be hundreds of megabytes: what stands beside them is put there at once, without a copy.

        Args:
            candidates: The effects.
            rows: Indices of the r readings.
            before: (3 r, f) columns that stand before them in what is returned; None: none.
            below: Number of rows of zeros that stand below them.
        """
        part, every = self.problem.select(rows), len(rows) == len(self.readings)
        last = 0 if before is None else before.shape[1]
        r, width = 3 * len(rows), last + sum(len(one.parameters) for one in candidates)
        result = np.empty((r + below, width))
        result[r:] = 0.0
        if before is not None:
            result[:r, :last] = before
        some = self.state if every else self.state.of_rows(rows)

        def columns(one: Candidate) -> Float3D:
            return one.columns(some) if every or one.row_by_row else one.columns(self.state)[rows]

        for k in range(0, len(candidates), TOGETHER):
            several = np.concatenate([columns(one) for one in candidates[k : k + TOGETHER]], axis=2)
            first, last = last, last + several.shape[2]
            result[:r, first:last] = weighted(part, self.parameters, several)
        return result

    def effects(self, candidates: Sequence[Candidate], *, apart: bool) -> Effects:
        """Return the columns of candidates as `moves`, for all readings.

        Args:
            candidates: The effects.
            apart: Whether levers and angles of those that only turn a joint may be kept apart.
        """
        joints = [str(one.location["joint"]) if apart and one.turns else "" for one in candidates]
        where, turns = np.repeat(joints, [len(one.parameters) for one in candidates]), []
        for name in dict.fromkeys(filter(None, joints)):
            lever = self.state.joint_column(self.state.chain.joints.index(name), np.ones(self.state.m))[:, :, None]
            weighed = weighted(self.problem, self.parameters, lever).reshape(-1, 3)
            angles = [one.turns(self.state) for one in candidates if one.turns and one.location["joint"] == name]
            turns.append(Turns(np.flatnonzero(where == name), weighed, np.concatenate(angles, axis=1)))
        others = [one for one, name in zip(candidates, joints, strict=True) if not name]
        whole = self.moves(others, np.arange(len(self.readings)))
        return Effects(np.flatnonzero(where == ""), whole, tuple(turns))


@dataclasses.dataclass(frozen=True, eq=False)
class Linear:
    """Columns of everything at one linearisation, per unit of the parameters.

    Those of the null model are written anew at every linearisation.  Those of effects stay as long as the compliances
    do: by what frames and geometry are corrected they change in the fourth digit.

    Attributes:
        model: About which those of the effects were written.
        own: In units of the claimed noise.
        white: The same as independent rows; the same object where the rows are independent as they are.
        products: (p, p) of the effects in `white`, over all readings.
    """

    model: NullModel
    own: Columns
    white: Columns
    products: Float2D

    @staticmethod
    def at(
        model: NullModel, whitening: Whitening, candidates: Sequence[Candidate], known: Linear | None
    ) -> tuple[Linear, Float1D]:
        """Linearise about a model, and return the residual of all rows there, too, (3 m,), units of the claimed noise.

        Args:
            model: The null model.
            whitening: Of all readings.
            candidates: The effects.
            known: The same about another model, if it serves here; None: not known.
        """
        everything = np.arange(len(model.readings))
        flat, residual = model.flat(everything)
        white_flat = whitening(flat)
        if known is not None:
            own = Columns(flat, known.own.effects)
            white = own if white_flat is flat else Columns(white_flat, known.white.effects)
            return Linear(known.model, own, white, known.products), residual
        own = Columns(flat, model.effects(candidates, apart=white_flat is flat))
        white = own if white_flat is flat else Columns(white_flat, Effects.of(whitening(own.effects.whole)))
        return Linear(model, own, white, white.effects.products), residual

    def serves(self, model: NullModel) -> bool:
        """Say whether the columns of effects are good about another model: compliances, and what joints carry."""
        old, new = self.model.parameters.compliance, model.parameters.compliance
        if np.any(np.abs(new - old) > STAY * old):
            return False
        if not (self.model.springs or model.springs):
            return True
        before, torque = self.model.state.torque, model.state.torque
        return not np.any(np.abs(torque - before) > STAY * np.abs(torque).max(axis=1, keepdims=True))

    def normal(self, aside: Int1D) -> Float2D:
        """Return the products of all columns, (f + p, f + p), without some readings, which are few."""
        whole = self.white.products(self.products)
        return whole - self.white.rows(aside).products() if len(aside) else whole


def state_at(problem: AbsoluteProblem, parameters: ModelParameters, readings: Readings, cell: Cell) -> State:
    """Return what effects may depend on, for all readings in the order of time.

    Raises:
        EquilibriumError: The compliances do not carry the loads.
    """
    chain = problem.chain.corrected(parameters.geometry)
    return recorded_state(readings, cell, chain, parameters, problem.load)


def sample(configuration: Int1D, used: Int1D) -> Int1D:
    """Return up to `SEARCHED` whole configurations' readings, evenly taken, as indices.

    Args:
        configuration: (m,) configuration of every reading.
        used: Indices of the readings that may be used.
    """
    numbers = numbers_in_time(configuration[used])
    if len(numbers) > SEARCHED:
        numbers = numbers[np.linspace(0, len(numbers) - 1, SEARCHED).astype(int)]
    return used[np.isin(configuration[used], numbers)]


def null_columns(part: AbsoluteProblem, parameters: ModelParameters, terms: Sequence[Term]) -> tuple[Float2D, Float1D]:
    """Return the columns of frames and geometry (3 r, n) and the residual (3 r,), in units of the claimed noise."""
    view = part.view(parameters)
    residual = (view.measured - view.target).T[:, :, None]
    movement = np.moveaxis(columns_of(view, terms), 0, -1).transpose(1, 0, 2)  # (r, 3, n)
    return weighted(part, parameters, movement), weighted(part, parameters, residual)[:, 0]


def weighted(part: AbsoluteProblem, parameters: ModelParameters, movement: Float3D) -> Float2D:
    """Return movements (r, 3, k) m, base axes, in units of the claimed noise, (3 r, k), reading after reading."""
    k = movement.shape[2]
    if isinstance(part.whitening, float):
        return (part.whitening * movement).reshape(3 * len(movement), k)
    to_noise = np.einsum("abm,cb->mac", part.whitening, parameters.tracker[:3, :3])
    return np.asarray(to_noise @ movement).reshape(3 * len(movement), k)


def unweighted(part: AbsoluteProblem, parameters: ModelParameters, values: Float1D) -> Float2D:
    """Return coordinates (3 r,) in units of the claimed noise in metres, (r, 3), base axes: undoes `weighted`."""
    rows = values.reshape(-1, 3)
    if isinstance(part.whitening, float):
        return rows / part.whitening
    to_noise = np.einsum("abm,cb->mac", part.whitening, parameters.tracker[:3, :3])
    return np.asarray(np.linalg.solve(to_noise, rows[:, :, None])[:, :, 0], dtype=np.float64)
