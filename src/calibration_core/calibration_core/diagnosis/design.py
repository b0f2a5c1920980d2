"""The recording and all hypotheses about it as one whitened linear model.

Rows are in units of the noise, offsets eliminated; columns are the null model's parameters, then those of every
candidate in units of its prior's standard deviation (three times the typical size), then nuisances: what instruments
and geometry are known to do and nobody would call a finding, in units of how large it is expected to be.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.identification.offsets import Rows, whitened
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D

PRIOR_WIDTH = 3.0  # standard deviations of the prior per typical size
HELD = 1e30  # weight, 1/(rad/(N*m))^2, of a compliance that is zero by declaration


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """Residual, null model and candidates, whitened.

    Attributes:
        residual: (r,) measured - null model.
        null: (r, n) columns of the null model's parameters.
        columns: (r, p) columns of all candidates, per standard deviation of the prior, and of the nuisances.
        configuration: (r,) index of the configuration of every row.
        candidates: The hypotheses.
        blocks: Their columns.
        prior: (p,) standard deviation of every parameter, in its unit.
        positive: (p,) whether physics allows no negative value.
        nuisances: Columns of the nuisances.
        joints: Names of the robot's joints, from the base on.
    """

    residual: Float1D
    null: Float2D
    columns: Float2D
    configuration: Int1D
    candidates: tuple[Candidate, ...]
    blocks: tuple[slice, ...]
    prior: Float1D
    positive: Bool1D
    nuisances: slice
    joints: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of null parameters."""
        return self.null.shape[1]

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
    nuisances: Float3D | None = None,
    used: Int1D | None = None,
) -> Design:
    """Evaluate every candidate's columns on all m readings (history needs them all), and whiten those used.

    Args:
        state: The null model.
        rows: Grouping and noise of the readings used.
        residual: (m, 3) m, measured - predicted.
        null: (m, 3, n) derivatives of the prediction by the null model's parameters.
        candidates: The hypotheses.
        nuisances: (m, 3, k) m per expected size; None where there are none.
        used: Indices of the readings used; None: all.
    """
    blocks, prior, positive, columns, start = [], [], [], [], 0
    for candidate in candidates:
        k = len(candidate.parameters)
        scale = PRIOR_WIDTH * np.array([parameter.typical for parameter in candidate.parameters])
        columns.append(candidate.columns(state) * scale)
        prior.append(scale)
        positive.append(np.array([parameter.positive for parameter in candidate.parameters]))
        blocks.append(slice(start, start + k))
        start += k
    extra = np.zeros((len(residual), 3, 0)) if nuisances is None else nuisances
    prior.append(np.ones(extra.shape[2]))
    positive.append(np.zeros(extra.shape[2], dtype=bool))
    data = np.concatenate([null, *columns, extra, residual[:, :, None]], axis=2)
    white, configuration = whitened(rows, data if used is None else data[used])
    n = null.shape[2]
    return Design(
        residual=white[:, -1],
        null=white[:, :n],
        columns=white[:, n:-1],
        configuration=configuration,
        candidates=candidates,
        blocks=tuple(blocks),
        prior=np.concatenate(prior),
        positive=np.concatenate(positive).astype(bool),
        nuisances=slice(start, start + extra.shape[2]),
        joints=state.chain.joints,
    )
