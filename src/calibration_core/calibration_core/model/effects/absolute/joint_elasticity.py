"""The robot sags under its own weight by axial compliance of a joint.

dq_j = C_j tau_g,j, the torque that gravity needs at joint j.  In absolute positions it is easily mistaken: its torque
goes with sine and cosine of the joint's angle as a first harmonic does, and any smooth column lowers a residual.  Hence
the controls: the gain must collapse when gravity is turned by 90 degrees, and stay beside a first harmonic.
Where masses are not known, the compliance times the first moments of the links beyond are the parameters: the torque is
linear in the moments, those of what a link carries included, about the origin of its frame and constant in it.
Source: axial joint compliance of CWA 17384, 6.2, under gravity; base parameters of the gravity torque (Khalil).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import cross, dot
from calibration_core.model.statics import gravity_torque
from calibration_core.timeseries import Float1D, Float2D, Float3D

AXIAL, UNKNOWN = "axial", "unknown masses"
WRIST = 3  # joints
LEAST = 1e-3  # m per compliance and kg*m: gravity does not load this joint


def _columns(state: State, joint: int) -> Float3D:
    return stacked(state.joint_column(joint, state.gravity_torque[joint]))


def _by_moments(state: State, joint: int, gravity: Float1D | None = None) -> Float3D:
    """Return (m, 3, k): sag per compliance times first moment, about x, y, z of each link from the joint's on.

    Of the joint's own link only x and y: what lies on the axis needs no torque.
    """
    pull = np.broadcast_to((state.chain.gravity if gravity is None else gravity)[:, None], (3, state.m))
    moving, links = state.at.moving, _heavy(state, joint)
    return stacked(*(
        state.joint_column(joint, dot(_axis(state, joint, link), cross(direction, pull)))
        for link in links
        for direction in moving.body[link][: 2 if link == links[0] else 3]
    ))  # fmt: skip


def _heavy(state: State, joint: int) -> range:
    """Return the links, by all moving joints, whose moments a joint's sag is made of; the wrist's go with the forearm.

    They begin at the joint, or at one before it that mimics it.
    """
    chain = state.chain
    first = int(np.flatnonzero(chain.matrix[:, joint])[0]) if chain.mimics else joint
    return range(first, chain.stage(max(chain.n - WRIST, joint) + 1))


def _axis(state: State, joint: int, link: int) -> Float2D:
    """Return the (3, m) angular velocity of a link, by all moving joints, per unit rate of a joint."""
    whole, matrix = state.at.whole, state.at.matrix
    if whole is None or matrix is None:
        return state.at.axis(joint)
    return np.asarray(np.tensordot(matrix[: link + 1, joint], whole.spins[: link + 1], axes=1))


def turned_columns(state: State, joint: int) -> Float3D:
    """Return (m, 3, 2): what sag would look like with gravity turned by 90 degrees about two axes: the control.

    Where masses are not known it is (m, 3, 2 k), both turned gravities with all moments.
    """
    if state.chain.mass is None:
        return np.concatenate([_by_moments(state, joint, gravity) for gravity in turned(state.chain.gravity)], axis=2)
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


def _unknown(state: State, joint: int) -> Candidate:
    size = typical("joint_elasticity", state.rated_load) * state.rated_load * state.chain.reach / 2
    unit = "kg*m*rad/(N*m)"
    names = [
        f"compliance_times_moment_{axis}_link_{link + 1}"
        for link in _heavy(state, joint)
        for axis in ("xy" if link == _heavy(state, joint)[0] else "xyz")
    ]
    parameters = tuple(Parameter(name, unit, size) for name in names)
    place = {"joint": state.chain.joints[joint]}
    return Candidate(EFFECT.name, EFFECT.family, place, UNKNOWN, parameters, partial(_by_moments, joint=joint))


def _without_masses(state: State) -> Iterator[Candidate]:
    if not np.any(state.chain.gravity):
        return
    for joint in state.chain.revolute:
        if state.chain.rigid[joint] or _lifts(state, joint):
            continue
        candidate = _unknown(state, joint)
        if np.abs(candidate.columns(state)).max(initial=0.0) > LEAST:
            yield candidate


def _lifts(state: State, joint: int) -> bool:
    """Say whether a joint that mimics it slides: the weight beyond, and not only its moments, then loads the joint."""
    return any(one.driver == joint and one.prismatic for one in state.chain.mimics)


def _candidates(state: State) -> Iterator[Candidate]:
    if state.chain.mass is None:
        yield from _without_masses(state)
        return
    for joint, name in enumerate(state.chain.joints):
        if not state.bears_weight(joint) or state.chain.rigid[joint]:
            continue
        slides = state.chain.prismatic[joint]
        size = typical("prismatic_elasticity" if slides else "joint_elasticity", state.rated_load)
        parameters = (Parameter("compliance", "m/N" if slides else "rad/(N*m)", size, positive=True),)
        columns = partial(_columns, joint=joint)
        yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, AXIAL, parameters, columns)


EFFECT = Effect(
    name="joint_elasticity",
    family="absolute",
    equation="dq_j = C_j tau_g,j",
    source="axial joint compliance (CWA 17384, 6.2) under gravity",
    reveal="the same poses with a second payload, or a loaded recording of this joint",
    candidates=_candidates,
    loaded=False,
    sentence="{place} sags under the robot's own weight",
    traits=frozenset({Trait.BY_WEIGHT}),
)
