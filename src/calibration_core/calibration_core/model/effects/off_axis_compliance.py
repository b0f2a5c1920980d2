"""Compliance of a joint across its axis: bearings and housings give way about the two other axes.

theta_u = C_u tau_u about x and y of the frame before the joint (DH frame i-1), or of the body frame behind it.
Source: virtual joints with several springs each (Pashkevich, Klimchik, Chablat); moment rigidity of reducers.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import X, Y, after_joint, before_joint, stacked
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

UNIT = "rad/(N*m)"


def _proximal(state: State, joint: int) -> Float3D:
    return stacked(before_joint(state, joint, X), before_joint(state, joint, Y))


def _distal(state: State, joint: int) -> Float3D:
    return stacked(after_joint(state, joint, X), after_joint(state, joint, Y))


def _isotropic(state: State, joint: int) -> Float3D:
    return stacked(before_joint(state, joint, X) + before_joint(state, joint, Y))


def _candidates(state: State) -> Iterator[Candidate]:
    size = typical("off_axis_compliance", state.rated_load)
    pair = (Parameter("compliance_x", UNIT, size), Parameter("compliance_y", UNIT, size))
    for joint, name in enumerate(state.chain.joints):
        place = {"joint": name}
        yield Candidate(EFFECT.name, EFFECT.family, place, "before", pair, partial(_proximal, joint=joint))
        yield Candidate(EFFECT.name, EFFECT.family, place, "behind", pair, partial(_distal, joint=joint))
        one = (Parameter("compliance", UNIT, size),)
        yield Candidate(EFFECT.name, EFFECT.family, place, "isotropic", one, partial(_isotropic, joint=joint))


EFFECT = Effect(
    name="off_axis_compliance",
    family="structure",
    equation="theta_u = C_u tau_u about the two axes across the joint's own",
    source="virtual joint method with several springs per joint (Pashkevich, Klimchik, Chablat 2011)",
    reveal="a second target on the link before the joint, and loads across its axis",
    candidates=_candidates,
    absolute=False,
)
