"""A load in one axis of the force/torque sensor shows in another.

w_read = (I + X) w with X off the diagonal, 30 numbers; to first order w = (I - X) w_read.
Source: cross-talk of the sensor's decoupling matrix.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.load_chain.wrench_gain import AXES, MOST
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

ARM = 0.2  # m: lever with which forces and torques of the sensor's range are compared


def _pairs(count: int) -> list[tuple[int, int]]:
    return [(to, source) for to in range(count) for source in range(count) if to != source]


def _columns(state: State, count: int) -> Float3D:
    return np.stack(
        [-state.by_wrench[:, :, to] * state.wrench[:, None, source] for to, source in _pairs(count)], axis=-1
    )


def _candidates(state: State) -> Iterator[Candidate]:
    size = typical("wrench_crosstalk", state.rated_load)
    for variant, count in (("forces", 3), ("all axes", 6)):
        parameters = []
        for to, source in _pairs(count):
            force_to_torque = to >= 3 > source
            torque_to_force = source >= 3 > to
            scale = ARM if force_to_torque else 1 / ARM if torque_to_force else 1.0
            unit = "m" if force_to_torque else "1/m" if torque_to_force else "1"
            parameters.append(Parameter(f"{AXES[source]}_to_{AXES[to]}", unit, size * scale, most=MOST * scale))
        columns = partial(_columns, count=count)
        yield Candidate(EFFECT.name, EFFECT.family, {"sensor": "force_torque"}, variant, tuple(parameters), columns)


EFFECT = Effect(
    name="wrench_crosstalk",
    family="load chain",
    equation="w_read = (I + X) w, X off the diagonal",
    source="decoupling matrix of the force/torque sensor",
    reveal="loads along every axis of the sensor",
    candidates=_candidates,
    absolute=False,
    sentence="the axes of the force/torque sensor influence each other",
)
