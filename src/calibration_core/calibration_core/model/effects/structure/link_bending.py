"""Bending and torsion of a link as a beam between its joint and the next.

u = F L^3/3EI + M L^2/2EI, phi = F L^2/2EI + M L/EI, torsion M L/GJ: rotary springs spread evenly along the link.
The weight of the link itself acts at its centre of gravity; or it rests on the link's joint, as the weight of motors
that sit there does.  A link reaches from the frame before its joint to the frame before the next joint, or from the
other end of its axis to that of the next (`Chain.other_end`); the next may be one that mimics another.
Source: Euler-Bernoulli beam by virtual work.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import along_link, stacked, tilting, turning
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, link_name, typical
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import cross
from calibration_core.timeseries import Float2D, Float3D

SHORTEST = 0.05  # m: shorter links do not bend
UNIT = "1/(N*m^2)"
ACROSS = 1e-6  # cosine: axes so near to right angles are equally so
ON_JOINT, OTHER_ENDS = ", own weight on its joint", ", between the other ends of the axes"
WEIGHT, ENDS = {"": True, ON_JOINT: False}, {"": False, OTHER_ENDS: True}
TURNED = 0.3  # typical size of the compliance between the two planes over that in them


def _ends(state: State, link: int, *, other_ends: bool) -> tuple[Float2D, Float2D]:
    return state.foot(link, other_end=other_ends), state.tip(link, other_end=other_ends)


def _axes(state: State, link: int, ends: tuple[Float2D, Float2D]) -> tuple[Float2D, Float2D, Float2D]:
    """Return two axes across the link (fixed in its body frame) and the one along it, (3, m) each."""
    start, tip = ends
    along = (tip - start) / np.linalg.norm(tip - start, axis=0)
    body = state.at.body[link]
    inner = np.array([abs(float(np.mean(np.sum(body[k] * along, axis=0)))) for k in range(3)])
    first = int(np.flatnonzero(inner < inner.min() + ACROSS)[0])  # not by rounding errors: the same in all recordings
    across = cross(along, body[first])
    across = across / np.linalg.norm(across, axis=0)
    return across, cross(along, across), along


def _bending(state: State, link: int, *, other_ends: bool, own_weight: bool) -> Float3D:
    ends = _ends(state, link, other_ends=other_ends)
    first, second, _ = _axes(state, link, ends)
    return along_link(
        state, link, ends, lambda cut, at: tilting(state, cut, (first, second), at), own_weight=own_weight
    )


def _whole(state: State, link: int, *, other_ends: bool, own_weight: bool) -> Float3D:
    ends = _ends(state, link, other_ends=other_ends)
    along = _axes(state, link, ends)[2]
    torsion = along_link(
        state, link, ends, lambda cut, at: stacked(turning(state, cut, along, at)), own_weight=own_weight
    )
    return np.concatenate([_bending(state, link, other_ends=other_ends, own_weight=own_weight), torsion], axis=2)


def _round(state: State, link: int, *, other_ends: bool, own_weight: bool) -> Float3D:
    """One bending stiffness for both directions, as of a tube."""
    return stacked(_bending(state, link, other_ends=other_ends, own_weight=own_weight)[:, :, :2].sum(axis=-1))


def _forms(state: State) -> Iterator[Candidate]:
    return (candidate for candidate, _, _ in _described(state))


def _described(state: State) -> Iterator[tuple[Candidate, bool, bool]]:
    """Return every form, whether the link's weight rests on its joint, and whether it lies between the other ends."""
    size = typical("link_bending", state.rated_load)
    one = (Parameter("bending", UNIT, size, positive=True),)
    two = (
        Parameter("bending_1", UNIT, size, positive=True),
        Parameter("bending_2", UNIT, size, positive=True),
        Parameter("bending_12", UNIT, TURNED * size),
    )
    three = (*two, Parameter("torsion", UNIT, 2 * size, positive=True))
    for link in range(state.chain.n):
        form = partial(Candidate, EFFECT.name, EFFECT.family, {"link": link_name(link)}, row_by_row=True)
        for (where, other_ends), (weight, own_weight) in itertools.product(ENDS.items(), WEIGHT.items()):
            start, tip = _ends(state, link, other_ends=other_ends)
            if float(np.linalg.norm(tip - start, axis=0).min()) < SHORTEST:
                continue
            bending, whole, tube = (
                partial(law, link=link, other_ends=other_ends, own_weight=own_weight)
                for law in (_bending, _whole, _round)
            )
            yield form(f"bending{where}{weight}", two, bending), not own_weight, other_ends
            yield form(f"bending and torsion{where}{weight}", three, whole), not own_weight, other_ends
            yield form(f"tube{where}{weight}", one, tube), not own_weight, other_ends


def _candidates(state: State) -> Iterator[Candidate]:
    """Leave out forms that are the same, and in recordings of loads all but those of the frames and the own weight.

    A link's own weight may rest on its joint where this and other weight bend the link.
    """
    whole, stages = state.chain.whole, [state.chain.stage(link) for link in range(state.chain.n)]
    mass = np.zeros(whole.n) if whole.mass is None else whole.mass
    apart = np.append(np.abs(whole.other_end), 0.0)
    heavy = {link_name(link) for link, k in enumerate(stages) if mass[k] > 0 and np.any(mass[k + 1 :] > 0)}
    other = {link_name(link) for link, k in enumerate(stages) if max(apart[k], apart[k + 1]) > SHORTEST}
    for candidate, *asks in _described(state):
        asked = [links for asks_it, links in zip(asks, (heavy, other), strict=True) if asks_it]
        if not asked or (not state.loaded and all(candidate.location["link"] in links for links in asked)):
            yield candidate


EFFECT = Effect(
    name="link_bending",
    family="structure",
    equation="u = F L^3/3EI + M L^2/2EI, phi = F L^2/2EI + M L/EI, torsion M L/GJ",
    source="Euler-Bernoulli beam theory, virtual work",
    reveal="a target at either end of the link; more configurations",
    candidates=_candidates,
    forms=_forms,
    sentence="{place} bends",
)
