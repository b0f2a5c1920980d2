"""Bending and torsion of a link as a beam between its joint and the next.

u = F L^3/3EI + M L^2/2EI, phi = F L^2/2EI + M L/EI, torsion M L/GJ: rotary springs spread evenly along the link.
The weight of the link itself bends it where its centre of gravity is; or it rests on the link's joint, as that of
motors does that sit there.  A link reaches from the frame of its joint to that of the next; or, where these stand
elsewhere on their axes, between the near ends of both.
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
NEAR_ENDS = ", between the near ends of the axes"
TURNED = 0.3  # typical size of the compliance between the two planes over that in them


def _ends(state: State, link: int, *, near: bool) -> tuple[Float2D, Float2D]:
    last = link == state.chain.n - 1
    return state.foot(link, near=near), state.at.flange_origin if last else state.place(link + 1, near=near)


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


def _bending(state: State, link: int, *, near: bool, own_weight: bool) -> Float3D:
    ends = _ends(state, link, near=near)
    first, second, _ = _axes(state, link, ends)
    return along_link(
        state, link, ends, lambda cut, at: tilting(state, cut, (first, second), at), own_weight=own_weight
    )


def _whole(state: State, link: int, *, near: bool, own_weight: bool) -> Float3D:
    ends = _ends(state, link, near=near)
    along = _axes(state, link, ends)[2]
    torsion = along_link(
        state, link, ends, lambda cut, at: stacked(turning(state, cut, along, at)), own_weight=own_weight
    )
    return np.concatenate([_bending(state, link, near=near, own_weight=own_weight), torsion], axis=2)


def _round(state: State, link: int, *, near: bool, own_weight: bool) -> Float3D:
    """One bending stiffness for both directions, as of a tube."""
    return stacked(_bending(state, link, near=near, own_weight=own_weight)[:, :, :2].sum(axis=-1))


def _forms(state: State) -> Iterator[Candidate]:
    size = typical("link_bending", state.rated_load)
    one = (Parameter("bending", UNIT, size, positive=True),)
    two = (
        Parameter("bending_1", UNIT, size, positive=True),
        Parameter("bending_2", UNIT, size, positive=True),
        Parameter("bending_12", UNIT, TURNED * size),
    )
    three = (*two, Parameter("torsion", UNIT, 2 * size, positive=True))
    for link in range(state.chain.n):
        form = partial(Candidate, EFFECT.name, EFFECT.family, {"link": link_name(link)})
        for where, near, own_weight in (("", False, True), (ON_JOINT, False, False), (NEAR_ENDS, True, True)):
            start, tip = _ends(state, link, near=near)
            if float(np.linalg.norm(tip - start, axis=0).min()) < SHORTEST:
                continue
            law = {"link": link, "near": near, "own_weight": own_weight}
            yield form(f"bending{where}", two, partial(_bending, **law))  # type: ignore[arg-type]
            yield form(f"bending and torsion{where}", three, partial(_whole, **law))  # type: ignore[arg-type]
            yield form(f"tube{where}", one, partial(_round, **law))  # type: ignore[arg-type]


def _candidates(state: State) -> Iterator[Candidate]:
    """Leave out forms that are the same.

    A link's own weight rests on its joint only where this and other weight bend the link, and no load does; the near
    ends of the axes are others only where a joint's frame stands elsewhere.
    """
    n = state.chain.n
    mass = np.zeros(n) if state.loaded or state.chain.mass is None else state.chain.mass
    heavy = {link_name(link) for link in range(n) if mass[link] > 0 and np.any(mass[link + 1 :] > 0)}
    other = {link_name(link) for link in range(n) if max(state.apart(link), state.apart(link + 1)) > SHORTEST}
    for candidate in _forms(state):
        asked = {ON_JOINT: heavy, NEAR_ENDS: other}
        if all(candidate.location["link"] in links or not candidate.variant.endswith(w) for w, links in asked.items()):
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
