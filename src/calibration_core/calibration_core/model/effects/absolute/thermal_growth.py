"""Links grow with temperature.

p = FK(q; l_i (1 + alpha dT)): the point moves by alpha dT times the vector that grows, dT from 20 degrees Celsius (what
is constant goes into the geometry).
Either the whole arm grows, from the base to the flange, or one link; the tool is no part of the robot.
Source: thermal expansion of metals.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, link_name, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Float3D

REFERENCE = 20.0  # degrees Celsius (ISO 1)
LEAST_RANGE = 0.5  # K; below it no growth can be determined
SHORTEST = 1e-3  # m: a shorter link does not grow


def _warmth(state: State) -> Float1D:
    return state.temperature - REFERENCE


def _arm(state: State) -> Float3D:
    return stacked((_warmth(state) * (state.at.flange_origin - state.at.origin[0])).T)


def _length(state: State, link: int) -> Float2D:
    """Return the (3, m) vector from the axis before a link to the one after it, or to the flange."""
    tips = [*state.at.origin[1:], state.at.flange_origin]
    return tips[link] - state.at.origin[link]


def _link(state: State, link: int) -> Float3D:
    return stacked((_warmth(state) * _length(state, link)).T)


def growths(state: State) -> Iterator[Candidate]:
    """Yield every growth that can be evaluated, whether or not these temperatures could tell it."""
    if not np.isfinite(state.temperature).all():
        return
    parameters = (Parameter("expansion", "1/K", typical("thermal_growth", state.rated_load)),)
    yield Candidate(EFFECT.name, EFFECT.family, {"robot": "arm"}, "uniform", parameters, _arm)
    for link in range(state.chain.n):
        if np.linalg.norm(_length(state, link), axis=0).max() < SHORTEST:
            continue
        place = {"link": link_name(link)}
        yield Candidate(EFFECT.name, EFFECT.family, place, "one link", parameters, partial(_link, link=link))


def _candidates(state: State) -> Iterator[Candidate]:
    if np.isfinite(state.temperature).all() and np.ptp(state.temperature) >= LEAST_RANGE:
        yield from growths(state)


EFFECT = Effect(
    name="thermal_growth",
    family="absolute",
    equation="p = FK(q; l_i (1 + alpha dT_i))",
    source="thermal expansion of steel and aluminium, 12 to 23 um per m and K",
    reveal="one pose every few configurations while the robot warms up, link temperatures recorded",
    candidates=_candidates,
    loaded=False,
    forms=growths,
    sentence="the robot grows with its temperature",
    traits=frozenset({Trait.HISTORY}),
)
