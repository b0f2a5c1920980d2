"""Springs beside joints that were found carry part of the load: laws of these joints feel what is left."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D

Acting = tuple[tuple[Candidate, Float1D], ...]  # effects that act on joints, with their parameters


def acting(candidates: Sequence[Candidate], values: Sequence[Float1D]) -> Acting:
    """Return those of several effects, (k,) parameters each, that act on a joint with a torque."""
    several = zip(candidates, values, strict=True)
    return tuple((one, value) for one, value in several if one.torques is not None and np.any(value))


def with_side_torques(state: State, springs: Acting) -> State:
    """Return a state in which joints carry the torques of springs beside them, too.

    Args:
        state: What load and weight do.
        springs: The effects, and their parameters.
    """
    if not springs:
        return state if state.side_torque is None else dataclasses.replace(state, side_torque=None)
    side = np.zeros((state.chain.n, state.m))
    for candidate, value in springs:
        if candidate.torques is not None:
            side[state.chain.joints.index(str(candidate.location["joint"]))] += candidate.torques(state) @ value
    return dataclasses.replace(state, side_torque=side)
