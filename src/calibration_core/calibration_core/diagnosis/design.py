"""The recording and all hypotheses about it as one whitened linear model.

Rows are in units of the noise, offsets eliminated; columns are the null model's parameters, then those of every
candidate in units of its prior's standard deviation (three times the typical size).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.identification.offsets import Rows, whitened
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

PRIOR_WIDTH = 3.0  # standard deviations of the prior per typical size


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """Residual, null model and candidates, whitened.

    Attributes:
        residual: (r,) measured - null model.
        null: (r, n) columns of the null model's parameters.
        columns: (r, p) columns of all candidates, per standard deviation of the prior.
        configuration: (r,) index of the configuration of every row.
        candidates: The hypotheses.
        blocks: Their columns.
        prior: (p,) standard deviation of every parameter, in its unit.
    """

    residual: Float1D
    null: Float2D
    columns: Float2D
    configuration: Int1D
    candidates: tuple[Candidate, ...]
    blocks: tuple[slice, ...]
    prior: Float1D

    @property
    def n(self) -> int:
        """Number of null parameters."""
        return self.null.shape[1]

    def gram(self) -> Float2D:
        """Return the Gram matrix of [null, columns, residual]."""
        everything = np.column_stack([self.null, self.columns, self.residual])
        return everything.T @ everything


def build_design(
    state: State, rows: Rows, residual: Float2D, null: Float3D, candidates: tuple[Candidate, ...], noise_scale: float
) -> Design:
    """Evaluate every candidate's columns and whiten the lot.

    Args:
        state: The null model.
        rows: Grouping and claimed noise.
        residual: (m, 3) m, measured - predicted.
        null: (m, 3, n) derivatives of the prediction by the null model's parameters.
        candidates: The hypotheses.
        noise_scale: Factor on the claimed standard deviations.
    """
    blocks, prior, columns, start = [], [], [], 0
    for candidate in candidates:
        k = len(candidate.parameters)
        scale = PRIOR_WIDTH * np.array([parameter.typical for parameter in candidate.parameters])
        columns.append(candidate.columns(state) * scale)
        prior.append(scale)
        blocks.append(slice(start, start + k))
        start += k
    data = np.concatenate([null, *columns, residual[:, :, None]], axis=2)
    white, configuration = whitened(rows, data)
    white = white / noise_scale
    n = null.shape[2]
    return Design(
        residual=white[:, -1],
        null=white[:, :n],
        columns=white[:, n:-1],
        configuration=configuration,
        candidates=candidates,
        blocks=tuple(blocks),
        prior=np.concatenate(prior) if prior else np.empty(0),
    )
