"""The tracker frame is turned against the base frame: deflections point in a wrong direction, everywhere the same.

d = (I + [b]x) d_read.  Source: registration of the tracker (CWA 17384, 5.2 and 7.1).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D


def _columns(state: State) -> Float3D:
    deflection = state.since_step_zero(state.point.T)
    return stacked(*(np.cross(axis, deflection) for axis in np.eye(3)))


def _candidates(state: State) -> Iterator[Candidate]:
    size = typical("tracker_frame_misalignment", state.rated_load)
    parameters = tuple(Parameter(f"rotation_{axis}", "rad", size) for axis in "xyz")
    yield Candidate(EFFECT.name, EFFECT.family, {"tracker": "tracker"}, "small rotation", parameters, _columns)


EFFECT = Effect(
    name="tracker_frame_misalignment",
    family="point chain",
    equation="d = (I + [b]x) d_read",
    source="registration of the tracker (CWA 17384, 5.2, 7.1)",
    reveal="absolute positions in many configurations",
    candidates=_candidates,
    absolute=False,
    sentence="the tracker stands turned against the cell file",
    traits=frozenset({Trait.FRAMES}),
    stated="frames.tracker",
)
