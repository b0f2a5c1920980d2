"""A joint goes on giving way under a constant torque.

theta = C tau + eps C int (1 - exp(-(t - s)/T)) dtau(s), T between 30 and 1000 s.  Steps are taken as held from one
reading to the next.  Source: linear viscoelasticity (standard linear solid).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float3D

TIMES = (30.0, 150.0, 800.0)  # s


def relaxed(state: State, torque: Float1D, constant: float) -> Float1D:
    """Return the (m,) creep integral of a torque (m,) that steps at the middle between two readings."""
    result = np.zeros(state.m)
    for index in state.sequences():
        values, time = torque[index], state.time[index]
        for k in range(1, index.shape[1]):
            for before in range(1, k + 1):
                change = values[:, before] - values[:, before - 1]
                since = time[:, k] - (time[:, before] + time[:, before - 1]) / 2
                result[index[:, k]] += change * (1 - np.exp(-np.clip(since, 0.0, None) / constant))
    return result


def _columns(state: State, joint: int, constant: float) -> Float3D:
    creeping = relaxed(state, state.load_torque[joint], constant)
    return stacked(state.joint_column(joint, state.compliance[joint] * creeping))


def _candidates(state: State) -> Iterator[Candidate]:
    if not np.isfinite(state.time).all():
        return
    parameter = Parameter("creep_share", "1", typical("creep", state.rated_load), positive=True)
    for joint, name in enumerate(state.chain.joints):
        if state.compliance[joint] > 0:
            for constant in TIMES:
                columns = partial(_columns, joint=joint, constant=constant)
                yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, f"{constant:g} s", (parameter,), columns)


EFFECT = Effect(
    name="creep",
    family="joint law",
    equation="theta = C tau + eps C int (1 - exp(-(t - s)/T)) dtau(s)",
    source="linear viscoelasticity, standard linear solid",
    reveal="ten-minute holds at full and at zero load",
    candidates=_candidates,
    absolute=False,
)
