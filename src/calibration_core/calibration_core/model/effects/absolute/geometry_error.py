"""A link is longer, an axis is tilted: errors of the frame before a joint.

d = J_g dg: translations move the point along the frame's axes, rotations turn it about them.  The null model for
absolute positions refits all of them that are distinguishable; a finding is the frame of one joint whose fitted error
is far beyond those of the others (`diagnosis.findings.geometry`).
Source: error models of serial robots (Hayati; Schroeer).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

AXES = ("x", "y", "z")


VARIANTS = {"frame before it": range(6), "frame before it, shifted": range(3), "frame before it, turned": range(3, 6)}


def _columns(state: State, joint: int, kinds: Sequence[int]) -> Float3D:
    frame, origin = state.at.before[joint], state.at.origin[joint]
    one = np.ones(state.m)
    turns = (state.rotation_column(axis, origin, one) for axis in frame)
    six = (*(axis.T for axis in frame), *turns)
    return stacked(*(six[kind] for kind in kinds))


def frame_error(joint: int, name: str, rated_load: float, variant: str = "frame before it") -> Candidate:
    """Return the hypothesis that the frame before a joint is displaced, or turned, or both, as `VARIANTS` says."""
    length, angle = typical("geometry_length", rated_load), typical("geometry_angle", rated_load)
    shifts = (Parameter(axis, "m", length) for axis in AXES)
    turns = (Parameter(f"r{axis}", "rad", angle) for axis in AXES)
    six, kinds = (*shifts, *turns), VARIANTS[variant]
    columns = partial(_columns, joint=joint, kinds=kinds)
    place = {"joint": name}
    return Candidate(EFFECT.name, EFFECT.family, place, variant, tuple(six[kind] for kind in kinds), columns)


def _candidates(state: State) -> Iterator[Candidate]:
    for joint, name in enumerate(state.chain.joints):
        yield frame_error(joint, name, state.rated_load)


EFFECT = Effect(
    name="geometry_error",
    family="absolute",
    equation="d = J_g dg",
    source="error models of serial robots (Hayati; Schroeer)",
    reveal="circles of single joints; absolute positions over the whole working space",
    candidates=_candidates,
    loaded=False,
    absolute=False,
    sentence="the geometry at {place} is off",
    traits=frozenset({Trait.GEOMETRY}),
)
