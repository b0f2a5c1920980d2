"""Springs in series with the chain: at the base, across the axes of joints, at the flange, and between two joints.

Off-axis compliance: about x and y of the frame before the joint (DH frame i-1), or of the body frame behind it; a
compliance between x and y turns the principal directions.  Where on its axis a bearing sits is not known: under
the robot's own weight both ends of the axis are tried (`Chain.other_end`).
Base: about the base axes and along them; it does not turn with joint 1.  Rocking about x and y is exactly what an
off-axis compliance of joint 1 does: loaded data cannot tell the two apart.
Tool: about the flange axes and along them.  What carries a tool seldom gives way about just these axes: the
compliances between them turn the principal directions.
Coupling: a symmetric compliance matrix of two joints, by reciprocity.  What gives way stores energy, so that the matrix
is positive: |C_ij| < sqrt(C_ii C_jj).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import combinations

import numpy as np

from calibration_core.model.effects.applied import sliding, stacked, tilting, turning
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, along_axes, typical
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


def _bearings(state: State) -> Iterator[Candidate]:
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
            form = partial(Candidate, OFF_AXIS.name, OFF_AXIS.family, {"joint": name}, row_by_row=True, shape=other_end)
            yield form(f"before{where}", several, partial(_proximal, joint=joint, other_end=other_end))
            yield form(f"behind{where}", several, partial(_distal, joint=joint, other_end=other_end))
            yield form(f"isotropic{where}", one, partial(_isotropic, joint=joint, other_end=other_end))


def _bearings_offered(state: State) -> Iterator[Candidate]:
    """Leave out the other end of an axis where both are one, and in recordings of loads."""
    ends = {name for name, apart in zip(state.chain.joints, state.chain.other_end, strict=True) if abs(apart) > APART}
    for candidate in _bearings(state):
        if not candidate.shape or (candidate.location["joint"] in ends and not state.loaded):
            yield candidate


OFF_AXIS = Effect(
    name="off_axis_compliance",
    family="structure",
    equation="theta_u = C_u tau_u about the two axes across the joint's own",
    source="virtual joint method with several springs per joint (Pashkevich, Klimchik, Chablat 2011)",
    reveal="a second target on the link before the joint, and loads across its axis",
    candidates=_bearings_offered,
    forms=_bearings,
    sentence="{place} tilts about an axis that is not its own",
)


BASE = before_joint(0)


def _base_springs(state: State, parts: int) -> Float3D:
    """Return the columns of rocking; of two parts with those of a turn about z, of three with those of slides, too."""
    axes = x, y, z = [np.broadcast_to(np.eye(3)[:, [k]], (3, state.m)) for k in range(3)]
    origin = np.zeros((3, state.m))
    columns = [tilting(state, BASE, (x, y), origin)]
    if parts > 1:
        columns.append(stacked(turning(state, BASE, z, origin)))
    if parts > 2:
        columns.append(stacked(*(sliding(state, BASE, axis) for axis in axes)))
    return np.concatenate(columns, axis=2)


def _bases(state: State) -> Iterator[Candidate]:
    turn, slide = typical("base_rotation", state.rated_load), typical("base_translation", state.rated_load)
    rocking = (
        Parameter("rotation_x", UNIT, turn, positive=True),
        Parameter("rotation_y", UNIT, turn, positive=True),
        Parameter("rotation_xy", UNIT, TURNED * turn),
    )
    about_z = Parameter("rotation_z", UNIT, turn, positive=True)
    slides = along_axes("translation", "m/N", slide, positive=True)
    form = partial(Candidate, BASE_COMPLIANCE.name, BASE_COMPLIANCE.family, {"base": "base"}, row_by_row=True)
    yield form("rocking", rocking, partial(_base_springs, parts=1))
    yield form("rotation", (*rocking, about_z), partial(_base_springs, parts=2))
    yield form("six springs", (*rocking, about_z, *slides), partial(_base_springs, parts=3))


BASE_COMPLIANCE = Effect(
    name="base_compliance",
    family="structure",
    equation="theta = C tau, u = c f at the base frame",
    source="six springs in series with the chain",
    reveal="a target on the base: it moves, or it does not; spread joint 1",
    candidates=_bases,
    sentence="the base gives way",
)


def _flange_springs(state: State, translations: int) -> Float3D:
    axes, flange = [state.at.flange[k] for k in range(3)], before_joint(state.chain.stage(state.chain.n))
    turns = [turning(state, flange, axis, state.at.flange_origin) for axis in axes]
    return stacked(*turns, *(sliding(state, flange, axis) for axis in axes[:translations]))


def _oblique(state: State) -> Float3D:
    x, y, z = (state.at.flange[k] for k in range(3))
    flange, origin = before_joint(state.chain.stage(state.chain.n)), state.at.flange_origin
    about_z = turning(state, flange, z, origin)
    between = [tilting(state, flange, (axis, z), origin)[:, :, 2] for axis in (x, y)]
    return np.concatenate([tilting(state, flange, (x, y), origin), stacked(about_z, *between)], axis=2)


def _bending(state: State) -> Float3D:
    return stacked(_flange_springs(state, 0)[:, :, :2].sum(axis=-1))


def _tools(state: State) -> Iterator[Candidate]:
    turn, slide = typical("tool_rotation", state.rated_load), typical("tool_translation", state.rated_load)
    turns = along_axes("rotation", UNIT, turn, positive=True)
    slides = along_axes("translation", "m/N", slide, positive=True)
    form = partial(Candidate, TOOL_COMPLIANCE.name, TOOL_COMPLIANCE.family, {"tool": "tool"})
    for name, translations in (("rotation", 0), ("six springs", 3)):
        columns = partial(_flange_springs, translations=translations)
        yield form(name, turns + slides[:translations], columns)
    x, y, z = turns
    xy, xz, yz = (Parameter(f"rotation_{axes}", UNIT, TURNED * turn) for axes in ("xy", "xz", "yz"))
    yield form("oblique rotation", (x, y, xy, z, xz, yz), _oblique)
    yield form("tilt", (Parameter("rotation_xy", UNIT, turn, positive=True),), _bending)


TOOL_COMPLIANCE = Effect(
    name="tool_compliance",
    family="structure",
    equation="theta = C tau, u = c f at the flange",
    source="six springs in series with the chain; CWA 17384, 5.1",
    reveal="targets on both sides of the adapter",
    candidates=_tools,
    absolute=False,
    sentence="the tool gives way",
)


UNSURE = 1.5  # so many times its stated value may a joint's compliance be


def _coupled(state: State, first: int, second: int) -> Float3D:
    torque = state.torque
    return stacked(state.joint_column(first, torque[second]) + state.joint_column(second, torque[first]))


def _couplings(state: State) -> Iterator[Candidate]:
    share = typical("joint_coupling", state.rated_load)
    known = state.compliance[state.compliance > 0]
    usual = float(np.median(known)) if len(known) else 1e-6
    c = np.where(state.compliance > 0, state.compliance, usual)
    for first, second in combinations(state.chain.revolute, 2):
        size = share * float(np.sqrt(c[first] * c[second]))
        place = {"joints": (state.chain.joints[first], state.chain.joints[second])}
        both = float(np.sqrt(state.compliance[first] * state.compliance[second]))
        parameter = Parameter("compliance", UNIT, size, most=UNSURE * both or math.inf)
        columns = partial(_coupled, first=first, second=second)
        yield Candidate(COUPLING.name, COUPLING.family, place, "symmetric", (parameter,), columns)


COUPLING = Effect(
    name="joint_coupling",
    family="structure",
    equation="theta_i = C_ij tau_j, theta_j = C_ij tau_i",
    source="wrist gear trains and parallelograms; Maxwell-Betti reciprocity",
    reveal="loads that put a torque on one of the two joints only",
    candidates=_couplings,
    sentence="{place} are coupled elastically",
)
