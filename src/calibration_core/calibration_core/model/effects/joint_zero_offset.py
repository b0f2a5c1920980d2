"""A joint's zero is wrong: every angle is off by the same amount.

d = (J_MP(q + dq) - J_MP(q)) ... in loaded data the deflection changes with the posture, by |dq| times the deflection.
In absolute data the zero is part of the geometry.  Source: mastering of the joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import cross
from calibration_core.timeseries import Float3D


def _columns(state: State, joint: int) -> Float3D:
    """Return how the deflected points turn with the joint, less what the undeflected ones do (an offset)."""
    axis, origin = state.at.axis(joint), state.at.origin[joint]
    turned = cross(axis, state.point - origin).T
    torque = _torque_slope(state, joint)
    answered = np.einsum("anm,nm->ma", state.answer, state.compliance[:, None] * torque)
    return state.since_step_zero(turned + answered)[..., None]


def _torque_slope(state: State, joint: int) -> np.ndarray:
    """Return d tau_i / d q_joint of the external load, (n, m), the wrench turning with the sensor."""
    axis_j, origin_j = state.at.axis(joint), state.at.origin[joint]
    slopes = np.zeros_like(state.load_torque)
    for i in range(joint):  # a turn before joint i carries axis, lever and wrench along
        axis, lever = state.at.axis(i), state.where - state.at.origin[i]
        d_lever = cross(axis_j, state.where - origin_j)
        d_moment = cross(d_lever, state.force) + cross(lever, cross(axis_j, state.force)) + cross(axis_j, state.moment)
        slopes[i] = np.sum(axis * d_moment, axis=0)
    return slopes


def zero_offset(joint: int, name: str, rated_load: float) -> Candidate:
    """Return the hypothesis that a joint's zero is elsewhere than its encoder says."""
    parameters = (Parameter("offset", "rad", typical("joint_zero_offset", rated_load)),)
    columns = partial(_columns, joint=joint)
    return Candidate(EFFECT.name, EFFECT.family, {"joint": name}, "zero", parameters, columns)


def _candidates(state: State) -> Iterator[Candidate]:
    for joint, name in enumerate(state.chain.joints):
        yield zero_offset(joint, name, state.rated_load)


EFFECT = Effect(
    name="joint_zero_offset",
    family="absolute",
    equation="q = q_read + dq",
    source="mastering of the joints",
    reveal="absolute positions; circles of the joint",
    candidates=_candidates,
    absolute=False,
)
