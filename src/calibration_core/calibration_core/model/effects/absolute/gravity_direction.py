"""The base stands askew to gravity, as on a floor that slopes: every joint bears another share of the weight.

d tau_j = a_j . sum (c_k - o_j) x m_k (e x g), for a turn about two axes e across gravity.  Movement by the joints'
compliances, which must therefore be known; by how much the whole robot leans is part of the tracker's pose.
Source: statics of the arm's own weight.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration_core.model.effects.absolute.joint_elasticity import turned
from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.model.statics import gravity_torque
from calibration_core.timeseries import Float3D


def _columns(state: State) -> Float3D:
    """Return (m, 3, 2) m/rad: turned by 90 degrees, gravity is what it changes by per radian."""
    torques = (gravity_torque(state.chain.with_gravity(across), state.at) for across in turned(state.chain.gravity))
    return stacked(*(np.sum(state.answer * (state.compliance[:, None] * one), axis=1).T for one in torques))


def _candidates(state: State) -> Iterator[Candidate]:
    if np.any(state.compliance[:, None] * state.gravity_torque):
        size = typical("gravity_direction", state.rated_load)
        parameters = tuple(Parameter(f"turn_{k}", "rad", size) for k in (1, 2))
        yield Candidate(EFFECT.name, EFFECT.family, {"base": "base"}, "turn about two axes", parameters, _columns)


EFFECT = Effect(
    name="gravity_direction",
    family="absolute",
    equation="d tau = d tau_g / d g (e x g)",
    source="statics of the arm's own weight",
    reveal="a spirit level on the base; the same poses with a second payload",
    candidates=_candidates,
    loaded=False,
    sentence="the {place} stands askew to gravity",
    traits=frozenset({Trait.BY_WEIGHT}),
    stated="robot.gravity",
)
