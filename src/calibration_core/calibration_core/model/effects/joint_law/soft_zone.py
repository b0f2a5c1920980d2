"""Extra compliance at low torque, as strain-wave gears have it.

theta = C (tau + s clip(tau, -T1, T1)); T1 between 8 and 40 % of the largest torque of the recording.
Source: makers' piecewise stiffness K1, K2, K3; Tuttle 1992.
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

WIDTHS = (0.08, 0.13, 0.2, 0.3)  # of the largest torque


def _columns(state: State, joint: int, of: str, width: float) -> Float3D:
    torque = acting_torque(state, joint, of)
    edge = width * state.largest_torque(joint)
    return stacked(state.joint_column(joint, state.compliance[joint] * np.clip(torque, -edge, edge)))


def _several(state: State, joint: int, of: str) -> Float3D:
    """A law that softens gradually: zones of all widths, one beside the other."""
    return np.concatenate([_columns(state, joint, of, width) for width in WIDTHS], axis=2)


def _forms(state: State, of: Callable[[State, int], tuple[str, ...]]) -> Iterator[Candidate]:
    size = typical("soft_zone", state.rated_load)
    parameter = Parameter("extra_compliance", "1", size, positive=True)
    for joint, name in enumerate(state.chain.joints):
        if state.compliance[joint] > 0:
            for torque in of(state, joint):
                for width in WIDTHS:
                    columns = partial(_columns, joint=joint, of=torque, width=width)
                    variant = f"{torque}, below {100 * width:g} %"
                    yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, variant, (parameter,), columns)
                several = tuple(
                    Parameter(f"extra_compliance_{100 * width:g}_percent", "1", size, positive=True) for width in WIDTHS
                )
                gradual = partial(_several, joint=joint, of=torque)
                yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, f"{torque}, gradual", several, gradual)


EFFECT = Effect(
    name="soft_zone",
    family="joint law",
    equation="theta = C (tau + s clip(tau, -T1, T1))",
    source="strain-wave gear catalogues (K1, K2, K3); Tuttle 1992",
    reveal="steps at 5 and 10 % of the load",
    candidates=partial(_forms, of=torques),
    forms=partial(_forms, of=all_torques),
    sentence="{place} is softer at small torques",
    traits=frozenset({Trait.OF_LARGEST_TORQUE}),
)
