"""Effects of a set-up, where several recordings of one robot are evaluated together: each recording has its own.

What belongs to the robot is one hypothesis for all recordings.  Load chain and point chain belong to the set-up:
sensor, tool, tracker and points were mounted anew, so that each recording is a place of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

OF_A_SET_UP = frozenset({"load chain", "point chain"})
RECORDING = "recording"  # in the location of such an effect: the number of its recording, from 1


def in_each_recording(candidates: Sequence[Candidate], state: State) -> tuple[Candidate, ...]:
    """Return the hypotheses, those of a set-up once for every recording."""
    if state.setups is None:
        return tuple(candidates)
    found: list[Candidate] = []
    for candidate in candidates:
        if candidate.family not in OF_A_SET_UP:
            found.append(candidate)
            continue
        found += [in_recording(candidate, str(number + 1)) for number in _numbers(candidate, state)]
    return tuple(found)


def in_recording(candidate: Candidate, number: str) -> Candidate:
    """Return a hypothesis about one recording's set-up; `number` is that of the recording, from 1."""
    columns = partial(_within, columns=candidate.columns, number=int(number) - 1)
    return dataclasses.replace(candidate, location={**candidate.location, RECORDING: number}, columns=columns)


def each_recording(columns: Callable[[State], Float3D], state: State) -> Float3D:
    """Return movements (m, 3, k) of one recording, or those of each of r recordings beside each other, (m, 3, r k)."""
    if state.setups is None:
        return columns(state)
    return np.concatenate([_within(state, columns, number) for number in state.setups.numbers], axis=2)


def _numbers(candidate: Candidate, state: State) -> Sequence[int]:
    """Return the recordings that an effect can be in; a measurement point is of one alone."""
    assert state.setups is not None  # noqa: S101 - asked for several recordings
    point = candidate.location.get("point")
    if isinstance(point, str) and point.startswith("#"):
        seen = state.setups.recording[state.point_index == int(point[1:])]
        return [int(number) for number in np.unique(seen)]
    return state.setups.numbers


def _within(state: State, columns: Callable[[State], Float3D], number: int) -> Float3D:
    """Return movements (m, 3, k) in one recording, in the axes of its own instruments; other readings do not move."""
    inside = np.zeros(state.m, dtype=bool) if state.setups is None else state.setups.recording == number
    return columns(state.seen_by(number)) * inside[:, None, None]
