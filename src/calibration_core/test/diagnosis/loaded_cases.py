"""Loaded recordings with a planted effect, for the tests of the diagnosis."""

from __future__ import annotations

import dataclasses

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
from calibration_core.timeseries import Float2D, Readings

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
