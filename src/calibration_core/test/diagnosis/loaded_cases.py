"""Loaded recordings with a planted effect, for the tests of the diagnosis."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from robots import STIFFNESS, loaded_readings

from calibration_core.cell import Cell
from calibration_core.diagnosis.evidence.extended import loaded_state
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.effects import candidates
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float1D, Float2D, Readings

TRUE = 1 / np.array(STIFFNESS)


def true_state(readings: Readings, cell: Cell) -> State:
    """Return the state of the true compliances under a recording."""
    truth = nominal_parameters(cell).replace(compliance=TRUE)
    return loaded_state(build_problem(readings, cell, chain_of(cell), truth), cell, TRUE)


def candidate_of(state: State, effect: str, variant: str, **location: object) -> Candidate:
    """Return one candidate of the catalogue."""
    return next(
        c
        for c in candidates(state)
        if c.effect == effect and c.variant == variant and all(c.location[k] == v for k, v in location.items())
    )


def shifted(readings: Readings, cell: Cell, shift: Float2D) -> Readings:
    """Return the readings with their points moved by (m, 3) m, base axes."""
    rotation = nominal_parameters(cell).tracker[:3, :3]
    return dataclasses.replace(readings, position=readings.position + shift @ rotation)


def planted(
    cell: Cell, seed: int, effect: str, variant: str, values: list[float], configurations: int = 14, **location: object
) -> Readings:
    """Return a recording with noise as claimed and one effect, by its own columns at the true compliances."""
    readings = loaded_readings(cell, seed, configurations)
    state = true_state(readings, cell)
    candidate = candidate_of(state, effect, variant, **location)
    return shifted(readings, cell, candidate.columns(state) @ np.array(values))


def dahl(sliding: Float1D, change: Float1D) -> Float1D:
    """Return how far friction has slid, -1 to 1, after a change of the torque in units of that which turns it."""
    return np.sign(change) + (sliding - np.sign(change)) * np.exp(-np.abs(change))


def friction(state: State, joint: int, seed: int, slides: Callable[[Float1D, Float1D], Float1D]) -> Float1D:
    """Return how far the friction of a joint has slid, (m,), -1 to 1; it stood anywhere when the joint arrived.

    Args:
        state: Of the recording.
        joint: Counted from 0.
        seed: Of where it stood.
        slides: (how far it has slid, change of the torque by the largest one) -> how far after that.
    """
    largest = state.largest_torque(joint)
    begun = np.random.default_rng(seed).uniform(-1.0, 1.0, 1 + int(state.configuration.max()))
    lag = np.empty(state.m)
    for index in state.sequences:
        torque, sliding = state.torque[joint][index], begun[state.configuration[index[:, 0]]]
        for k in range(index.shape[1]):
            sliding = slides(sliding, (torque[:, k] - torque[:, max(k - 1, 0)]) / largest)
            lag[index[:, k]] = sliding
    return lag
