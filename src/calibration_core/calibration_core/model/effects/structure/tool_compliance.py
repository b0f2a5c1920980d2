"""Adapter, tool plate or flange give way: springs at the flange.

theta = C tau about the flange axes, u = c f along them.  What carries a tool seldom gives way about just these axes:
the compliances between them turn the principal directions.
Source: six springs in series with the chain; CWA 17384, 5.1, demands equipment in the flow of forces that is much
stiffer than the robot.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import sliding, stacked, tilting, turning
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.model.virtual_joints import before_joint
from calibration_core.timeseries import Float3D

TURNED = 0.3  # typical size of a compliance between two axes over that about them


def _columns(state: State, translations: int) -> Float3D:
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
    return stacked(_columns(state, 0)[:, :, :2].sum(axis=-1))


def _candidates(state: State) -> Iterator[Candidate]:
    turn, slide = typical("tool_rotation", state.rated_load), typical("tool_translation", state.rated_load)
    turns = tuple(Parameter(f"rotation_{axis}", "rad/(N*m)", turn, positive=True) for axis in "xyz")
    slides = tuple(Parameter(f"translation_{axis}", "m/N", slide, positive=True) for axis in "xyz")
    place = {"tool": "tool"}
    for name, translations in (("rotation", 0), ("six springs", 3)):
        columns = partial(_columns, translations=translations)
        yield Candidate(EFFECT.name, EFFECT.family, place, name, turns + slides[:translations], columns)
    x, y, z = turns
    xy, xz, yz = (Parameter(f"rotation_{axes}", "rad/(N*m)", TURNED * turn) for axes in ("xy", "xz", "yz"))
    yield Candidate(EFFECT.name, EFFECT.family, place, "oblique rotation", (x, y, xy, z, xz, yz), _oblique)
    tilt = (Parameter("rotation_xy", "rad/(N*m)", turn, positive=True),)
    yield Candidate(EFFECT.name, EFFECT.family, place, "tilt", tilt, _bending)


EFFECT = Effect(
    name="tool_compliance",
    family="structure",
    equation="theta = C tau, u = c f at the flange",
    source="six springs in series with the chain; CWA 17384, 5.1",
    reveal="targets on both sides of the adapter",
    candidates=_candidates,
    absolute=False,
    sentence="the tool gives way",
)
