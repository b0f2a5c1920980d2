"""The robot sags under its own weight by axial compliance of a joint.

dq_j = C_j tau_g,j, the torque that gravity needs at joint j.  In absolute positions it is easily mistaken: its torque
goes with sine and cosine of the joint's angle as a first harmonic does, and any smooth column lowers a residual.  Hence
the controls: the gain must collapse when gravity is turned by 90 degrees, and stay beside a first harmonic.
Source: axial joint compliance of CWA 17384, 6.2, under gravity.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.model.statics import gravity_torque
from calibration_core.timeseries import Float1D, Float3D


def _columns(state: State, joint: int) -> Float3D:
    return stacked(state.joint_column(joint, state.gravity_torque[joint]))


def turned_columns(state: State, joint: int) -> Float3D:
    """Return (m, 3, 2): what sag would look like with gravity turned by 90 degrees about two axes: the control."""
    columns = []
    for gravity in turned(state.chain.gravity):
        torque = gravity_torque(state.chain.with_gravity(gravity), state.at)
        columns.append(state.joint_column(joint, torque[joint]))
    return stacked(*columns)


def turned(gravity: Float1D) -> tuple[Float1D, Float1D]:
    """Return gravity, (3,) m/s^2, turned by 90 degrees about two axes perpendicular to it and to each other."""
    size = float(np.linalg.norm(gravity))
    down = gravity / size
    first = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    first /= np.linalg.norm(first)
    return size * first, size * np.cross(down, first)


def _candidates(state: State) -> Iterator[Candidate]:
    for joint, name in enumerate(state.chain.joints):
        if not state.bears_weight(joint) or state.chain.rigid[joint]:
            continue
        slides = state.chain.prismatic[joint]
        size = typical("prismatic_elasticity" if slides else "joint_elasticity", state.rated_load)
        parameters = (Parameter("compliance", "m/N" if slides else "rad/(N*m)", size),)
        columns = partial(_columns, joint=joint)
        yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, "axial", parameters, columns)


EFFECT = Effect(
    name="joint_elasticity",
    family="absolute",
    equation="dq_j = C_j tau_g,j",
    source="axial joint compliance (CWA 17384, 6.2) under gravity",
    reveal="the same poses with a second payload, or a loaded recording of this joint",
    candidates=_candidates,
    loaded=False,
)
