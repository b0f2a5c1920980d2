"""Bending and torsion of a link as a beam between its joint and the next.

u = F L^3/3EI + M L^2/2EI, phi = F L^2/2EI + M L/EI, torsion M L/GJ: rotary springs spread evenly along the link.
The weight of the link itself bends it where its centre of gravity is; or it rests on the link's joint, as that of
motors does that sit there.
Source: Euler-Bernoulli beam by virtual work.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, link_name
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import along_link, stacked, tilting, turning
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import cross
from calibration_core.timeseries import Float2D, Float3D

SHORTEST = 0.05  # m: shorter links do not bend
UNIT = "1/(N*m^2)"
ACROSS = 1e-6  # cosine: axes so near to right angles are equally so
ON_JOINT = ", own weight on its joint"
TURNED = 0.3  # typical size of the compliance between the two planes over that in them


def _ends(state: State, link: int) -> tuple[Float2D, Float2D]:
    last = link == state.chain.n - 1
    return state.foot(link), state.at.flange_origin if last else state.place(link + 1)


def _axes(state: State, link: int) -> tuple[Float2D, Float2D, Float2D]:
    """Return two axes across the link (fixed in its body frame) and the one along it, (3, m) each."""
    start, tip = _ends(state, link)
    along = (tip - start) / np.linalg.norm(tip - start, axis=0)
    body = state.at.body[link]
    inner = np.array([abs(float(np.mean(np.sum(body[k] * along, axis=0)))) for k in range(3)])
    first = int(np.flatnonzero(inner < inner.min() + ACROSS)[0])  # not by rounding errors: the same in all recordings
    across = cross(along, body[first])
    across = across / np.linalg.norm(across, axis=0)
    return across, cross(along, across), along


def _bending(state: State, link: int, *, own_weight: bool = True) -> Float3D:
    _, tip = _ends(state, link)
    first, second, _ = _axes(state, link)
    return along_link(
        state, link, tip, lambda cut, at: tilting(state, cut, (first, second), at), own_weight=own_weight
    )


def _whole(state: State, link: int, *, own_weight: bool = True) -> Float3D:
    _, tip = _ends(state, link)
    along = _axes(state, link)[2]
    torsion = along_link(
        state, link, tip, lambda cut, at: stacked(turning(state, cut, along, at)), own_weight=own_weight
    )
    return np.concatenate([_bending(state, link, own_weight=own_weight), torsion], axis=2)


def _round(state: State, link: int, *, own_weight: bool = True) -> Float3D:
    """One bending stiffness for both directions, as of a tube."""
    return stacked(_bending(state, link, own_weight=own_weight)[:, :, :2].sum(axis=-1))


def _forms(state: State) -> Iterator[Candidate]:
    size = typical("link_bending", state.rated_load)
    two = (
        Parameter("bending_1", UNIT, size, positive=True),
        Parameter("bending_2", UNIT, size, positive=True),
        Parameter("bending_12", UNIT, TURNED * size),
    )
    for link in range(state.chain.n):
        start, tip = _ends(state, link)
        if float(np.linalg.norm(tip - start, axis=0).min()) < SHORTEST:
            continue
        form = partial(Candidate, EFFECT.name, EFFECT.family, {"link": link_name(link)})
        one = (Parameter("bending", UNIT, size, positive=True),)
        three = (*two, Parameter("torsion", UNIT, 2 * size, positive=True))
        for own_weight, where in ((True, ""), (False, ON_JOINT)):
            yield form(f"bending{where}", two, partial(_bending, link=link, own_weight=own_weight))
            yield form(f"bending and torsion{where}", three, partial(_whole, link=link, own_weight=own_weight))
            yield form(f"tube{where}", one, partial(_round, link=link, own_weight=own_weight))


def _candidates(state: State) -> Iterator[Candidate]:
    """Leave out where a link's own weight rests, unless this and other weight bend the link, and no load does."""
    mass = np.zeros(state.chain.n) if state.loaded or state.chain.mass is None else state.chain.mass
    heavy = {link_name(link) for link in range(state.chain.n) if mass[link] > 0 and np.any(mass[link + 1 :] > 0)}
    for candidate in _forms(state):
        if not candidate.variant.endswith(ON_JOINT) or candidate.location["link"] in heavy:
            yield candidate


EFFECT = Effect(
    name="link_bending",
    family="structure",
    equation="u = F L^3/3EI + M L^2/2EI, phi = F L^2/2EI + M L/EI, torsion M L/GJ",
    source="Euler-Bernoulli beam theory, virtual work",
    reveal="a target at either end of the link; more configurations",
    candidates=_candidates,
    forms=_forms,
)
