"""The tool's weight, or its error, bends the joints: a mass at the flange and its first moments.

d tau_j = a_j . ((c - o_j) x M g), movement by the joints' compliances, which must therefore be known.
Source: statics of the tool.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import by_axis, dot, linear_jacobian
from calibration_core.timeseries import Float2D, Float3D

ARM = 0.2  # m, typical distance of a tool's centre of gravity from the flange


def pulled(state: State, where: Float2D, force: Float2D) -> Float2D:
    """Return the (m, 3) m that a force (3, m) N at points (3, m) m moves the measured point, by the joints alone."""
    moved = np.zeros((3, state.m))
    torque = dot(by_axis(linear_jacobian(state.at, where)), force[:, None])
    for joint, compliance in enumerate(state.compliance):
        moved += state.answer[:, joint] * (compliance * torque[joint])
    return moved.T


def _columns(state: State) -> Float3D:
    gravity = np.broadcast_to(state.chain.gravity[:, None], (3, state.m))
    weight = pulled(state, state.at.flange_origin, gravity)
    levers = [pulled(state, state.at.flange_origin + axis, gravity) - weight for axis in state.at.flange]
    return stacked(weight, *levers)


def _candidates(state: State) -> Iterator[Candidate]:
    if not np.any(state.compliance):
        return
    mass = typical("tool_weight", state.rated_load)
    moments = tuple(Parameter(f"moment_{axis}", "kg*m", ARM * mass) for axis in "xyz")
    parameters = (Parameter("mass", "kg", mass), *moments)
    yield Candidate(EFFECT.name, EFFECT.family, {"tool": "tool"}, "mass and first moments", parameters, _columns)


EFFECT = Effect(
    name="tool_weight",
    family="load chain",
    equation="d tau_j = a_j . ((c - o_j) x M g)",
    source="statics of the tool",
    reveal="the same poses with and without the tool, or with a second payload",
    candidates=_candidates,
    loaded=False,
    sentence="the weight of the tool is not what the model takes it for",
    traits=frozenset({Trait.ACTS_IN_USE}),
)
