"""The stiffness of a joint's transmission changes with its angle.

theta = C tau (1 + a cos q + b sin q).  Source: tooth contact and eccentricity over one turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D


def modulated(state: State, joint: int) -> Float3D:
    """Return the (m, 3, 2) columns of a compliance that follows cos q and sin q, relative to the joint's own."""
    deflection = state.compliance[joint] * state.torque[joint]
    angle = state.q[:, joint]
    return stacked(*(state.joint_column(joint, deflection * wave) for wave in (np.cos(angle), np.sin(angle))))


def _candidates(state: State) -> Iterator[Candidate]:
    size = typical("pose_dependent_stiffness", state.rated_load)
    pair = (Parameter("cosine", "1", size), Parameter("sine", "1", size))
    for joint in state.chain.revolute:
        name = state.chain.joints[joint]
        if state.compliance[joint] > 0 and (state.bears_weight(joint) or state.bears_load(joint)):
            place = {"joint": name}
            yield Candidate(EFFECT.name, EFFECT.family, place, "one turn", pair, partial(modulated, joint=joint))


EFFECT = Effect(
    name="pose_dependent_stiffness",
    family="structure",
    equation="theta = C tau (1 + a cos q + b sin q)",
    source="tooth contact and eccentricity over one turn of the joint",
    reveal="the same load at six or more values of the joint's angle",
    candidates=_candidates,
)
