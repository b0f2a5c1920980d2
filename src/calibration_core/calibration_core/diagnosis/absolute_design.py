"""An absolute recording and all hypotheses about it as one linear model, on a sample of its configurations.

Rows are coordinates, weighted as in the fit; columns are the null model's parameters (frames and geometry), then those
of every candidate in units of its prior's standard deviation.  The sample is for the search only: what is found is
fitted to all readings (see `absolute_fit`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry import AbsoluteProblem
from calibration_core.identification.terms import Term, names_of
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings

PRIOR_WIDTH = 3.0  # standard deviations of the prior per typical size
SEARCHED = 1_000  # configurations in the sample


@dataclasses.dataclass(frozen=True, eq=False)
class AbsoluteDesign:
    """The linear model on the sample.

    Attributes:
        residual: (3 s,) measured - null model, weighted so that one coordinate's claimed noise is 1.
        null: (3 s, n) columns of the null model.
        columns: (3 s, p) columns of all candidates, per standard deviation of the prior.
        candidates: The hypotheses.
        blocks: Their columns.
        rows: (s,) which readings were sampled.
    """

    residual: Float1D
    null: Float2D
    columns: Float2D
    candidates: tuple[Candidate, ...]
    blocks: tuple[slice, ...]
    rows: Int1D

    def of(self, chosen: Sequence[int]) -> Float2D:
        """Return the null model's columns and those of the chosen candidates, every one of length one."""
        parts = [self.null, *(self.columns[:, self.blocks[index]] for index in chosen)]
        wide = np.concatenate(parts, axis=1)
        length = np.linalg.norm(wide, axis=0)
        return wide / np.where(length > 0, length, 1.0)


def absolute_state(problem: AbsoluteProblem, parameters: ModelParameters, readings: Readings, cell: Cell) -> State:
    """Return what effects may depend on, for all readings in the order of time.

    Raises:
        EquilibriumError: The compliances do not carry the robot's own weight.
    """
    points = np.stack([parameters.points[name] for name in readings.points])[readings.point].T
    return state_of(
        problem.chain.corrected(parameters.geometry),
        readings.q,
        parameters.compliance,
        problem.load,
        points,
        point_index=readings.point,
        wrench=readings.wrench if problem.load is not None else None,
        configuration=np.unique(readings.configuration, return_inverse=True)[1].reshape(-1).astype(np.int64),
        step=readings.step,
        time=readings.time,
        temperature=readings.temperature,
        tracker=parameters.tracker,
        rated_load=cell.robot.rated_load,
    )


def sample(configuration: Int1D, used: Int1D) -> Int1D:
    """Return up to `SEARCHED` whole configurations' readings, evenly taken, as indices.

    Args:
        configuration: (m,) configuration of every reading.
        used: Indices of the readings that may be used.
    """
    numbers = np.unique(configuration[used])
    if len(numbers) > SEARCHED:
        numbers = numbers[np.linspace(0, len(numbers) - 1, SEARCHED).astype(int)]
    return used[np.isin(configuration[used], numbers)]


def build_absolute_design(
    problem: AbsoluteProblem,
    parameters: ModelParameters,
    terms: Sequence[Term],
    state: State,
    candidates: Sequence[Candidate],
    rows: Int1D,
    nuisances: Sequence[Candidate] = (),
) -> AbsoluteDesign:
    """Evaluate residual and columns at the null model, for the given readings.

    Args:
        problem: All readings.
        parameters: The null model's values.
        terms: What it fits.
        state: All readings' state there; effects that depend on the order of the poses need them all.
        candidates: The hypotheses.
        rows: Which readings to keep.
        nuisances: Hypotheses that are part of the null model.
    """
    blocks, start = [], 0
    columns = np.empty((3 * len(rows), sum(len(candidate.parameters) for candidate in candidates)))
    part = problem.select(rows)
    for candidate in candidates:
        block = slice(start, start + len(candidate.parameters))
        scale = PRIOR_WIDTH * np.array([parameter.typical for parameter in candidate.parameters])
        columns[:, block] = weighted(part, parameters, candidate.columns(state)[rows] * scale)
        blocks.append(block)
        start = block.stop
    null, residual = null_columns(part, parameters, terms)
    extra = [weighted(part, parameters, nuisance.columns(state)[rows]) for nuisance in nuisances]
    null = np.concatenate([null, *extra], axis=1)
    return AbsoluteDesign(residual, null, columns, tuple(candidates), tuple(blocks), rows)


def null_columns(part: AbsoluteProblem, parameters: ModelParameters, terms: Sequence[Term]) -> tuple[Float2D, Float1D]:
    """Return the null model's columns (3 s, n) and the residual (3 s,), weighted, reading after reading."""
    view = part.view(parameters)
    columns = np.empty((len(names_of(terms)), *view.target.shape))
    first = 0
    for term in terms:
        count = len(term.names)
        term.write(view, columns[first : first + count])
        first += count
    residual = (view.measured - view.target).T[:, :, None]
    movement = np.moveaxis(columns, 0, -1).transpose(1, 0, 2)  # (s, 3, n)
    return weighted(part, parameters, movement), weighted(part, parameters, residual)[:, 0]


def weighted(part: AbsoluteProblem, parameters: ModelParameters, movement: Float3D) -> Float2D:
    """Return movements (s, 3, k) m, base axes, in units of the claimed noise, (3 s, k), reading after reading."""
    k = movement.shape[2]
    if isinstance(part.whitening, float):
        return (part.whitening * movement).reshape(-1, k)
    to_noise = np.einsum("abm,cb->mac", part.whitening, parameters.tracker[:3, :3])
    return np.einsum("mac,mck->mak", to_noise, movement).reshape(-1, k)


def unweighted(part: AbsoluteProblem, parameters: ModelParameters, values: Float1D) -> Float2D:
    """Return weighted coordinates (3 s,) in metres, (s, 3), base axes: the inverse of `weighted`."""
    rows = values.reshape(-1, 3)
    if isinstance(part.whitening, float):
        return rows / part.whitening
    to_noise = np.einsum("abm,cb->mac", part.whitening, parameters.tracker[:3, :3])
    return np.asarray(np.linalg.solve(to_noise, rows[:, :, None])[:, :, 0], dtype=np.float64)
