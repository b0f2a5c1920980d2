"""The zero of the force/torque sensor drifts with time.

w = w_read - b' t.  Source: creep and temperature of strain gauges.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.load_chain.wrench_gain import AXES
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D


def _columns(state: State) -> Float3D:
    return -state.by_wrench * (state.time - state.time.min())[:, None, None]


def _candidates(state: State) -> Iterator[Candidate]:
    if not np.isfinite(state.time).all():
        return
    force = typical("wrench_drift_force", state.rated_load)
    torque = typical("wrench_drift_torque", state.rated_load)
    parameters = tuple(
        Parameter(f"drift_{name}", "N/s" if axis < 3 else "N*m/s", force if axis < 3 else torque)
        for axis, name in enumerate(AXES)
    )
    yield Candidate(EFFECT.name, EFFECT.family, {"sensor": "force_torque"}, "linear in time", parameters, _columns)


EFFECT = Effect(
    name="wrench_drift",
    family="load chain",
    equation="w = w_read - b' t",
    source="creep and temperature of strain gauges",
    reveal="unloaded readings and a tare before and after every configuration",
    candidates=_candidates,
    absolute=False,
    sentence="the force/torque sensor drifts",
    traits=frozenset({Trait.DRIFT}),
)
