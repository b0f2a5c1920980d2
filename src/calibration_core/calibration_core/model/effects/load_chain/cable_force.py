"""The hose package pulls at the flange towards where it is held on the arm, or a loop of it winds up with one joint.

d tau_j = a_j . ((p - o_j) x F e), e from the flange to the origin of a joint further back; d tau_j = k q_j, of which
the constant is a zero of the joint.  Movement by the joints' compliances, which must therefore be known.  Source:
statics; hoses pull by some tens of newtons, and are springs where they bend.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.load_chain.tool_weight import pulled
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

LAWS = {1: "winds up with", 3: "winds up, ever stiffer, with"}  # power of the angle
SHORTEST = 1e-3  # m; nearer holds give no direction


def _columns(state: State, holder: int) -> Float3D:
    pull = state.at.origin[holder] - state.at.flange_origin
    length = np.maximum(np.linalg.norm(pull, axis=0), SHORTEST)
    return stacked(pulled(state, state.at.flange_origin, pull / length))


def _wound_columns(state: State, joint: int, power: int) -> Float3D:
    turned = state.compliance[joint] * state.q[:, [joint]] ** np.arange(1, power + 1)
    return stacked(*(state.joint_column(joint, one) for one in turned.T))


def _candidates(state: State) -> Iterator[Candidate]:
    if not np.any(state.compliance):
        return
    parameters = (Parameter("force", "N", typical("cable_force", state.rated_load)),)
    for holder in range(state.chain.n - 1):
        variant = f"held at {state.chain.joints[holder]}"
        columns = partial(_columns, holder=holder)
        yield Candidate(EFFECT.name, EFFECT.family, {"tool": "tool"}, variant, parameters, columns)
    size = typical("cable_stiffness", state.rated_load)
    names = ("stiffness", "N*m/rad"), ("stiffening", "N*m/rad^2"), ("stiffening_square", "N*m/rad^3")
    stiffness = tuple(Parameter(*name, size) for name in names)
    for joint, (power, how) in itertools.product(state.chain.revolute, LAWS.items()):
        if state.compliance[joint] > 0:
            variant, columns = f"{how} {state.chain.joints[joint]}", partial(_wound_columns, joint=joint, power=power)
            yield Candidate(EFFECT.name, EFFECT.family, {"tool": "tool"}, variant, stiffness[:power], columns)


EFFECT = Effect(
    name="cable_force",
    family="load chain",
    equation="d tau_j = a_j . ((p - o_j) x F e), or k q_j",
    source="statics of a hose package",
    reveal="the same poses with and without the hose package",
    candidates=_candidates,
    loaded=False,
    sentence="a cable or dress pack pulls",
    traits=frozenset({Trait.ACTS_IN_USE}),
)
