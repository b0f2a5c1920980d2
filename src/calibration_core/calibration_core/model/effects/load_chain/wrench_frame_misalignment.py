"""The force/torque sensor is turned against its frame in the cell file.

f = (I + [a]x) f_read, t likewise.  Source: mounting.
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
        turned = np.hstack([np.cross(axis, state.wrench[:, :3]), np.cross(axis, state.wrench[:, 3:])])
        columns.append(np.einsum("mak,mk->ma", state.by_wrench, turned))
    return stacked(*columns)


def _candidates(state: State) -> Iterator[Candidate]:
    size = typical("wrench_frame_misalignment", state.rated_load)
    parameters = tuple(Parameter(f"rotation_{axis}", "rad", size) for axis in "xyz")
    sensor = {"sensor": "force_torque"}
    yield Candidate(EFFECT.name, EFFECT.family, sensor, "small rotation", parameters, _columns)


EFFECT = Effect(
    name="wrench_frame_misalignment",
    family="load chain",
    equation="w = (I + [a]x) w_read",
    source="mounting of the sensor",
    reveal="a known mass hung in three orientations",
    candidates=_candidates,
    absolute=False,
    sentence="the force/torque sensor is turned against the cell file",
    stated="frames.force_torque",
)
