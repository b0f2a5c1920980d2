"""The tracker, or the robot's base, moves slowly against the other.

d = t (v + om x p), p the absolute position.  Source: thermal drift of stands and floors.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.model.effects.traits import Trait
from calibration_core.timeseries import Float3D


def _columns(state: State) -> Float3D:
    time = (state.time - state.time.min())[:, None]
    arm = state.point.T - state.tracker[:3, 3]
    shifts = [time * np.broadcast_to(axis, (state.m, 3)) for axis in np.eye(3)]
    return stacked(*shifts, *(time * np.cross(axis, arm) for axis in np.eye(3)))


def _candidates(state: State) -> Iterator[Candidate]:
    if not np.isfinite(state.time).all():
        return
    shift, turn = typical("tracker_drift", state.rated_load), typical("tracker_drift_rotation", state.rated_load)
    parameters = tuple(Parameter(f"velocity_{axis}", "m/s", shift) for axis in "xyz") + tuple(
        Parameter(f"rate_{axis}", "rad/s", turn) for axis in "xyz"
    )
    yield Candidate(EFFECT.name, EFFECT.family, {"tracker": "tracker"}, "linear in time", parameters, _columns)


EFFECT = Effect(
    name="tracker_drift",
    family="point chain",
    equation="d = t (v + om x p)",
    source="thermal drift of stands and floors",
    reveal="the home pose every three to five configurations; fixed reference targets",
    candidates=_candidates,
    sentence="the tracker drifts",
    traits=frozenset({Trait.DRIFT, Trait.HISTORY}),
)
