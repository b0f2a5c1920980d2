"""Pedestal, anchors and floor give way: springs at the origin of the base frame.

theta = C tau about the base axes, u = c f along them; it does not turn with joint 1.  Rocking about x and y is exactly
what an off-axis compliance of joint 1 does: loaded data cannot tell the two apart.
Source: six springs in series with the chain.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import sliding, stacked, tilting, turning
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.model.virtual_joints import before_joint
from calibration_core.timeseries import Float2D, Float3D

BASE = before_joint(0)
TURN = "rad/(N*m)"
TURNED = 0.3  # typical size of the compliance between x and y over that about them


def _rocking(state: State) -> Float3D:
    x, y, _ = _axes(state)
    return tilting(state, BASE, (x, y), np.zeros((3, state.m)))


def _rotation(state: State) -> Float3D:
    turn = turning(state, BASE, _axes(state)[2], np.zeros((3, state.m)))
    return np.concatenate([_rocking(state), stacked(turn)], axis=2)


def _six(state: State) -> Float3D:
    return np.concatenate([_rotation(state), stacked(*(sliding(state, BASE, axis) for axis in _axes(state)))], axis=2)


def _axes(state: State) -> tuple[Float2D, Float2D, Float2D]:
    x, y, z = (np.broadcast_to(np.eye(3)[:, [k]], (3, state.m)) for k in range(3))
    return x, y, z


def _candidates(state: State) -> Iterator[Candidate]:
    turn, slide = typical("base_rotation", state.rated_load), typical("base_translation", state.rated_load)
    rocking = (
        Parameter("rotation_x", TURN, turn, positive=True),
        Parameter("rotation_y", TURN, turn, positive=True),
        Parameter("rotation_xy", TURN, TURNED * turn),
    )
    about_z = Parameter("rotation_z", TURN, turn, positive=True)
    slides = tuple(Parameter(f"translation_{axis}", "m/N", slide, positive=True) for axis in "xyz")
    form = partial(Candidate, EFFECT.name, EFFECT.family, {"base": "base"}, row_by_row=True)
    yield form("rocking", rocking, _rocking)
    yield form("rotation", (*rocking, about_z), _rotation)
    yield form("six springs", (*rocking, about_z, *slides), _six)


EFFECT = Effect(
    name="base_compliance",
    family="structure",
    equation="theta = C tau, u = c f at the base frame",
    source="six springs in series with the chain",
    reveal="a target on the base: it moves, or it does not; spread joint 1",
    candidates=_candidates,
    sentence="the base gives way",
)
