"""A joint crosses its clearance when its torque changes sign.

theta = C tau + (b/2) clip(tau/tau_b, -1, 1), tau_b a few percent of the largest torque of the recording.
Source: definition of lost motion at +-3 % of the rated torque.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.joint_law.nonlinear_stiffness import acting_torque, all_torques, torques
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

WIDTHS = (0.003, 0.02, 0.04, 0.06)  # of the largest torque


def _columns(state: State, joint: int, of: str, width: float) -> Float3D:
    torque = acting_torque(state, joint, of)
    edge = width * state.largest_torque(joint)
    return stacked(state.joint_column(joint, np.clip(torque / edge, -1.0, 1.0) / 2))


def _forms(state: State, of: Callable[[State, int], tuple[str, ...]]) -> Iterator[Candidate]:
    size = typical("backlash", state.rated_load)
    for joint, name in enumerate(state.chain.joints):
        parameter = Parameter("clearance", state.chain.units[joint], size, positive=True)
        for torque in of(state, joint):
            for width in WIDTHS:
                columns = partial(_columns, joint=joint, of=torque, width=width)
                variant = f"{torque}, within {100 * width:g} %"
                yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, variant, (parameter,), columns)


EFFECT = Effect(
    name="backlash",
    family="joint law",
    equation="theta = C tau + (b/2) clip(tau/tau_b, -1, 1)",
    source="lost motion at +-3 % of the rated torque",
    reveal="reversed loads, small loads, configurations without gravity torque on the joint",
    candidates=partial(_forms, of=torques),
    forms=partial(_forms, of=all_torques),
    sentence="{place} has backlash",
    traits=frozenset({Trait.LAG, Trait.OF_LARGEST_TORQUE}),
)
