"""Compliance of a joint across its axis: bearings and housings give way about the two other axes.

theta_u = C_u tau_u about x and y of the frame before the joint (DH frame i-1), or of the body frame behind it; a
compliance between x and y turns the principal directions.  Where on its axis a bearing sits is not known: under
the robot's own weight both ends of the axis are tried (`Chain.other_end`).
Source: virtual joints with several springs each (Pashkevich, Klimchik, Chablat); moment rigidity of reducers.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from calibration_core.model.effects.applied import stacked, tilting
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.model.virtual_joints import before_joint, behind_joint
from calibration_core.timeseries import Float3D

UNIT = "rad/(N*m)"
X, Y = 0, 1
OTHER_END = ", other end of its axis"
APART = 0.05  # m: nearer to each other, both ends are one
TURNED = 0.3  # typical size of the compliance between x and y over that about them


def _proximal(state: State, joint: int, *, other_end: bool = False) -> Float3D:
    axes = state.at.before[joint]
    return tilting(
        state, before_joint(state.chain.stage(joint)), (axes[X], axes[Y]), state.place(joint, other_end=other_end)
    )


def _distal(state: State, joint: int, *, other_end: bool = False) -> Float3D:
    axes = state.at.body[joint]
    return tilting(
        state, behind_joint(state.chain.stage(joint)), (axes[X], axes[Y]), state.foot(joint, other_end=other_end)
    )


def _isotropic(state: State, joint: int, *, other_end: bool = False) -> Float3D:
    return stacked(_proximal(state, joint, other_end=other_end)[:, :, :2].sum(axis=-1))


def _forms(state: State) -> Iterator[Candidate]:
    """Return every form; its shape is whether the bearing sits at the other end of its axis."""
    size = typical("off_axis_compliance", state.rated_load)
    several = (
        Parameter("compliance_x", UNIT, size, positive=True),
        Parameter("compliance_y", UNIT, size, positive=True),
        Parameter("compliance_xy", UNIT, TURNED * size),
    )
    for joint, name in enumerate(state.chain.joints):
        one = (Parameter("compliance", UNIT, size, positive=True),)
        for other_end, where in ((False, ""), (True, OTHER_END)):
            form = partial(Candidate, EFFECT.name, EFFECT.family, {"joint": name}, row_by_row=True, shape=other_end)
            yield form(f"before{where}", several, partial(_proximal, joint=joint, other_end=other_end))
            yield form(f"behind{where}", several, partial(_distal, joint=joint, other_end=other_end))
            yield form(f"isotropic{where}", one, partial(_isotropic, joint=joint, other_end=other_end))


def _candidates(state: State) -> Iterator[Candidate]:
    """Leave out the other end of an axis where both are one, and in recordings of loads."""
    ends = {name for name, apart in zip(state.chain.joints, state.chain.other_end, strict=True) if abs(apart) > APART}
    for candidate in _forms(state):
        if not candidate.shape or (candidate.location["joint"] in ends and not state.loaded):
            yield candidate


EFFECT = Effect(
    name="off_axis_compliance",
    family="structure",
    equation="theta_u = C_u tau_u about the two axes across the joint's own",
    source="virtual joint method with several springs per joint (Pashkevich, Klimchik, Chablat 2011)",
    reveal="a second target on the link before the joint, and loads across its axis",
    candidates=_candidates,
    forms=_forms,
    sentence="{place} tilts about an axis that is not its own",
)
