"""The recording and all hypotheses about it as one whitened linear model.

Rows are in units of the noise, offsets eliminated; columns are the null model's parameters, then those of every
candidate in units of its prior's standard deviation (three times the typical size), then the structured
discrepancy: what instruments and geometry are known to do and nobody would call a finding, in units of how large it is
expected to be; last, what candidates leave to chance in each configuration.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Sequence

import numpy as np

from calibration_core.identification.statistics.offsets import Rows, whitened
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

PRIOR_WIDTH = 3.0  # standard deviations of the prior per typical size
HELD = 1e30  # weight, 1/(rad/(N*m))^2, of a compliance that is zero by declaration


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """Residual, null model and candidates, whitened.

    Attributes:
        residual: (r,) measured - null model.
        null: (r, n) columns of the null model's parameters.
        columns: (r, p) columns of all candidates, per standard deviation of the prior, of the discrepancy, of chance.
        configuration: (r,) index of the configuration of every row.
        candidates: The hypotheses.
        blocks: Their columns.
        prior: (p,) standard deviation of every parameter, in its unit.
        discrepancy: Columns of the structured discrepancy.
        chances: Of every candidate, the columns of what it leaves to chance.
        joints: Names of the robot's joints, from the base on.
    """

    residual: Float1D
    null: Float2D
    columns: Float2D
    configuration: Int1D
    candidates: tuple[Candidate, ...]
    blocks: tuple[slice, ...]
    prior: Float1D
    discrepancy: slice
    chances: tuple[slice, ...]
    joints: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of null parameters."""
        return self.null.shape[1]

    def own(self, candidate: int) -> Int1D:
        """Return the (k,) columns that a candidate brings with it: its parameters, and what it leaves to chance."""
        parts = (self.blocks[candidate], self.chances[candidate])
        return np.concatenate([np.arange(part.start, part.stop) for part in parts])

    def known(self, accepted: Sequence[int]) -> Float2D:
        """Return the (r, q) columns of null model, accepted candidates with their chance, and discrepancy."""
        own = [self.columns[:, self.own(index)] for index in accepted]
        return np.column_stack([self.null, *own, self.columns[:, self.discrepancy]])

    def fitted(self, accepted: Sequence[int]) -> Float2D:
        """Return the (r, n + k) columns of null model and accepted candidates alone."""
        return np.column_stack([self.null, *(self.columns[:, self.blocks[index]] for index in accepted)])

    def gram(self) -> Float2D:
        """Return the Gram matrix of [null, columns, residual]; a rigid joint is held at zero."""
        everything = np.column_stack([self.null, self.columns, self.residual])
        gram = everything.T @ everything
        held = np.flatnonzero(np.diag(gram)[: self.n] == 0.0)
        gram[held, held] = HELD
        return gram


def build_design(
    state: State,
    rows: Rows,
    residual: Float2D,
    null: Float3D,
    candidates: tuple[Candidate, ...],
    discrepancy: Float3D | None = None,
    used: Int1D | None = None,
    *,
    among: Collection[int] | None = None,
    chance: bool = True,
) -> Design:
    """Evaluate candidates' columns on all m readings (history needs them all), and whiten those used.

    Args:
        state: The null model.
        rows: Grouping and noise of the readings used.
        residual: (m, 3) m, measured - predicted.
        null: (m, 3, n) derivatives of the prediction by the null model's parameters.
        candidates: The hypotheses.
        discrepancy: (m, 3, k) m per expected size; None where there are none.
        used: Indices of the readings used; None: all.
        among: Indices of the hypotheses that are evaluated, the others have no columns; None: all.
        chance: Whether to evaluate what candidates leave to chance; offers, of which there are thousands, do without.
    """
    blocks, prior, columns, start = [], [], [], 0
    evaluated = frozenset(range(len(candidates)) if among is None else among)
    for index, candidate in enumerate(candidates):
        if index in evaluated:
            scale = PRIOR_WIDTH * np.array([parameter.typical for parameter in candidate.parameters])
            columns.append(candidate.columns(state) * scale)
            prior.append(scale)
        k = len(candidate.parameters) if index in evaluated else 0
        blocks.append(slice(start, start + k))
        start += k
    extra = np.zeros((len(residual), 3, 0)) if discrepancy is None else discrepancy
    random, places = _chances(state, candidates, evaluated if chance else frozenset(), start + extra.shape[2])
    columns += [extra, *random]
    more = sum(part.shape[2] for part in (extra, *random))
    prior.append(np.ones(more))
    data = np.concatenate([null, *columns, residual[:, :, None]], axis=2)
    white, configuration = whitened(rows, data, used)
    n = null.shape[2]
    return Design(
        residual=white[:, -1],
        null=white[:, :n],
        columns=white[:, n:-1],
        configuration=configuration,
        candidates=candidates,
        blocks=tuple(blocks),
        prior=np.concatenate(prior),
        discrepancy=slice(start, start + extra.shape[2]),
        chances=places,
        joints=state.chain.joints,
    )


def _chances(
    state: State, candidates: tuple[Candidate, ...], evaluated: frozenset[int], start: int
) -> tuple[list[Float3D], tuple[slice, ...]]:
    """Return the columns of what is left to chance, once for all with the same function, and whose they are."""
    several = [candidate.chances if index in evaluated else None for index, candidate in enumerate(candidates)]
    functions = dict.fromkeys(function for function in several if function is not None)
    columns = [function(state) for function in functions]
    ends = list(itertools.accumulate((part.shape[2] for part in columns), initial=start))
    own = dict(zip(functions, itertools.starmap(slice, itertools.pairwise(ends)), strict=True))
    nothing = slice(start, start)
    return columns, tuple(nothing if function is None else own[function] for function in several)
