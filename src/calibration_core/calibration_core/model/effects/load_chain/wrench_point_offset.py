"""The point to which the wrench is reduced is not where the cell file says.

The moment is wrong by e x f.  Source: lever arm of the sensor's origin or of the wrench point (CWA 17384, 7.4).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D


def _columns(state: State) -> Float3D:
    columns = []
    for axis in np.eye(3):
        moment = np.cross(axis, state.wrench[:, :3])
        columns.append(np.einsum("mak,mk->ma", state.by_wrench[:, :, 3:], moment))
    return stacked(*columns)


def _candidates(state: State) -> Iterator[Candidate]:
    size = typical("wrench_point_offset", state.rated_load)
    parameters = tuple(Parameter(f"offset_{axis}", "m", size) for axis in "xyz")
    yield Candidate(EFFECT.name, EFFECT.family, {"sensor": "force_torque"}, "lever arm", parameters, _columns)


EFFECT = Effect(
    name="wrench_point_offset",
    family="load chain",
    equation="t = t_read + e x f",
    source="lever arm of the wrench (CWA 17384, 7.4)",
    reveal="measure the point in known configurations; pure moments",
    candidates=_candidates,
    absolute=False,
    sentence="the load pulls at another point than stated",
    stated="frames.force_torque",
    stated_otherwise="frames.wrench_point where wrench_at is wrench_point",
)
