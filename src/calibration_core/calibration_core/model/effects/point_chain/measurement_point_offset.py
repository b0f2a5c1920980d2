"""A measurement point is not where the cell file puts it on the tool: its lever arm is wrong.

d = theta_tool x u.  Source: CWA 17384, 7.5.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D


def _columns(state: State, points: tuple[int, ...]) -> Float3D:
    axes = np.moveaxis(state.at.flange, -1, 0).transpose(0, 2, 1)  # (m, 3, 3), columns are flange axes
    columns = np.zeros((state.m, 3, 3 * len(points)))
    for k, point in enumerate(points):
        rows = state.point_index == point
        columns[rows, :, 3 * k : 3 * k + 3] = axes[rows]
    return state.since_step_zero(columns)


def _candidates(state: State) -> Iterator[Candidate]:
    size = typical("measurement_point_offset", state.rated_load)
    present = tuple(int(point) for point in np.unique(state.point_index))
    for point in present:
        parameters = tuple(Parameter(f"offset_{axis}", "m", size) for axis in "xyz")
        place = {"point": f"#{point}"}
        yield Candidate(EFFECT.name, EFFECT.family, place, "one point", parameters, partial(_columns, points=(point,)))


EFFECT = Effect(
    name="measurement_point_offset",
    family="point chain",
    equation="d = theta_tool x u",
    source="lever arm of a measurement point (CWA 17384, 7.5)",
    reveal="measure the point in known configurations",
    candidates=_candidates,
    absolute=False,
    sentence="target {place} is at another place than stated",
    traits=frozenset({Trait.FRAMES}),
    stated="frames.measurement_points",
)
