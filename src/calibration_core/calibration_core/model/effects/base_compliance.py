"""Pedestal, anchors and floor give way: springs at the origin of the base frame.

theta = C tau about the base axes, u = c f along them; it does not turn with joint 1.
Source: six springs in series with the chain.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D


def _columns(state: State, rotations: int, translations: int) -> Float3D:
    zero = np.zeros((3, state.m))
    axes = [np.broadcast_to(np.eye(3)[:, [k]], (3, state.m)) for k in range(3)]
    turns = [state.spring_column(axis, zero) for axis in axes[:rotations]]
    return stacked(*turns, *(state.slide_column(axis) for axis in axes[:translations]))


def _candidates(state: State) -> Iterator[Candidate]:
    turn, slide = typical("base_rotation", state.rated_load), typical("base_translation", state.rated_load)
    turns = tuple(Parameter(f"rotation_{axis}", "rad/(N*m)", turn) for axis in "xyz")
    slides = tuple(Parameter(f"translation_{axis}", "m/N", slide) for axis in "xyz")
    place = {"base": "base"}
    for name, rotations, translations in (("rocking", 2, 0), ("rotation", 3, 0), ("six springs", 3, 3)):
        parameters = turns[:rotations] + slides[:translations]
        columns = partial(_columns, rotations=rotations, translations=translations)
        yield Candidate(EFFECT.name, EFFECT.family, place, name, parameters, columns)


EFFECT = Effect(
    name="base_compliance",
    family="structure",
    equation="theta = C tau, u = c f at the base frame",
    source="six springs in series with the chain",
    reveal="a target on the base: it moves, or it does not; spread joint 1",
    candidates=_candidates,
    absolute=False,
)
