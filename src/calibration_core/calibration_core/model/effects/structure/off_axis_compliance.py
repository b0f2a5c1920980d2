"""Compliance of a joint across its axis: bearings and housings give way about the two other axes.

theta_u = C_u tau_u about x and y of the frame before the joint (DH frame i-1), or of the body frame behind it; a
compliance between x and y turns the principal directions.  Where on its axis a bearing sits is not known: it is at the
joint's frame or, if that is elsewhere, at the near end of the axis.
Source: virtual joints with several springs each (Pashkevich, Klimchik, Chablat); moment rigidity of reducers.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked, tilting
from calibration_core.model.effects.state import State
from calibration_core.model.virtual_joints import before_joint, behind_joint
from calibration_core.timeseries import Float3D

UNIT = "rad/(N*m)"
X, Y = 0, 1
NEAR_END = ", near end of its axis"
APART = 0.05  # m: nearer to each other, both ends are one
TURNED = 0.3  # typical size of the compliance between x and y over that about them


def _proximal(state: State, joint: int, *, near: bool = False) -> Float3D:
    axes = state.at.before[joint]
    return tilting(state, before_joint(joint), (axes[X], axes[Y]), state.place(joint, near=near))


def _distal(state: State, joint: int, *, near: bool = False) -> Float3D:
    axes = state.at.body[joint]
    return tilting(state, behind_joint(joint), (axes[X], axes[Y]), state.foot(joint, near=near))


def _isotropic(state: State, joint: int, *, near: bool = False) -> Float3D:
    return stacked(_proximal(state, joint, near=near)[:, :, :2].sum(axis=-1))


def _forms(state: State) -> Iterator[Candidate]:
    size = typical("off_axis_compliance", state.rated_load)
    several = (
        Parameter("compliance_x", UNIT, size, positive=True),
        Parameter("compliance_y", UNIT, size, positive=True),
        Parameter("compliance_xy", UNIT, TURNED * size),
    )
    for joint, name in enumerate(state.chain.joints):
        form = partial(Candidate, EFFECT.name, EFFECT.family, {"joint": name})
        one = (Parameter("compliance", UNIT, size, positive=True),)
        for near, where in ((False, ""), (True, NEAR_END)):
            yield form(f"before{where}", several, partial(_proximal, joint=joint, near=near))
            yield form(f"behind{where}", several, partial(_distal, joint=joint, near=near))
            yield form(f"isotropic{where}", one, partial(_isotropic, joint=joint, near=near))


def _candidates(state: State) -> Iterator[Candidate]:
    """Leave out the near end where the joint's frame stands there."""
    ends = {name for joint, name in enumerate(state.chain.joints) if state.apart(joint) > APART}
    for candidate in _forms(state):
        if not candidate.variant.endswith(NEAR_END) or candidate.location["joint"] in ends:
            yield candidate


EFFECT = Effect(
    name="off_axis_compliance",
    family="structure",
    equation="theta_u = C_u tau_u about the two axes across the joint's own",
    source="virtual joint method with several springs per joint (Pashkevich, Klimchik, Chablat 2011)",
    reveal="a second target on the link before the joint, and loads across its axis",
    candidates=_candidates,
    forms=_forms,
)
