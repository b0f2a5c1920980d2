"""The protocols of the proof: what is measured, with which loads.

L: 18 configurations, oblique pull, 0-25-50-75-100-75-50-25-0 percent, three points.  R: the same, then reversed.
W: dead weights, three levels, one point.  A: 60 configurations, one step each, no load.  LA and RA: L or R, and then
36 configurations of one step each.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_sim.configurations import random_protocol
from calibration_sim.protocol import FOUR_STEPS, NINE_STEPS, Configuration, Protocol, pull, rated_force

REVERSED = (*NINE_STEPS, *(-level for level in NINE_STEPS[1:]))
LOADED, ABSOLUTE, BESIDES = 18, 60, 36
KINDS = ("L", "R", "W", "A", "LA", "RA")


def make_protocol(cell: Cell, kind: str, seed: int) -> Protocol:
    """Draw the configurations and loads of a protocol; the same seed gives the same one.

    Args:
        cell: The cell; its nominal geometry decides what can be reached and seen.
        kind: One of `KINDS`.
        seed: Of configurations and directions.

    Raises:
        PlanError: Too few configurations can be reached and seen.
    """
    parts: list[Configuration] = []
    if kind[0] in "LR":
        levels = NINE_STEPS if kind[0] == "L" else REVERSED
        parts += random_protocol(cell, LOADED, seed, levels=levels).configurations
    if kind == "W":
        down = pull(np.asarray(cell.gravity), rated_force(cell), FOUR_STEPS)
        drawn = random_protocol(cell, LOADED, seed).configurations
        parts += [dataclasses.replace(configuration, wrenches=down) for configuration in drawn]
    if kind.endswith("A"):
        count = ABSOLUTE if kind == "A" else BESIDES
        still = random_protocol(cell, count, seed + 1, levels=(0.0,)).configurations
        parts += [dataclasses.replace(c, number=len(parts) + c.number) for c in still]
    return Protocol(tuple(parts))


def points_of(cell: Cell, kind: str) -> tuple[str, ...]:
    """Return the names of the points that a protocol measures."""
    names = tuple(cell.frames.measurement_points)
    return names[:1] if kind == "W" else names
