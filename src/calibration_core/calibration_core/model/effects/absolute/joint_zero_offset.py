"""A joint's zero is wrong: every angle is off by the same amount.

d = (J_MP(q + dq) - J_MP(q)) ... in loaded data the deflection changes with the posture, by |dq| times the deflection.
In absolute data the zero is part of the geometry.  Source: mastering of the joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.model.virtual_joints import behind_joint
from calibration_core.timeseries import Float3D


def _columns(state: State, joint: int) -> Float3D:
    if state.at.whole is not None:  # the joints that mimic it move, too, and not as one body
        return stacked(state.since_step_zero(state.joint_column(joint, np.ones(state.m))))
    moved = np.einsum("akm,km->ma", state.virtual.answer(behind_joint(joint)), np.concatenate(state.at.screw(joint)))
    return stacked(state.since_step_zero(moved))


def zero_offset(joint: int, name: str, rated_load: float, unit: str = "rad") -> Candidate:
    """Return the hypothesis that a joint's zero is elsewhere than its encoder says."""
    parameters = (Parameter("offset", unit, typical("joint_zero_offset", rated_load)),)
    columns = partial(_columns, joint=joint)
    return Candidate(EFFECT.name, EFFECT.family, {"joint": name}, "zero", parameters, columns)


def _candidates(state: State) -> Iterator[Candidate]:
    for joint, name in enumerate(state.chain.joints):
        yield zero_offset(joint, name, state.rated_load, state.chain.units[joint])


EFFECT = Effect(
    name="joint_zero_offset",
    family="absolute",
    equation="q = q_read + dq",
    source="mastering of the joints",
    reveal="absolute positions; circles of the joint",
    candidates=_candidates,
    absolute=False,
    sentence="the zero of {place} is off",
    traits=frozenset({Trait.GEOMETRY}),
)
