"""The protocols of the proof: what is measured, with which loads.

L: 18 configurations, oblique pull, 0-25-50-75-100-75-50-25-0 percent, three points.  R: the same, then reversed.
W: dead weights, three levels, one point.  S: the least that CWA 17384 allows, 12 configurations, zero and full load,
one point.  A: 60 configurations, one step each, no load.  LA and RA: L or R, and then 36 configurations of one step
each.  Numbers say how many instead: L5A40 is L in 5 configurations, and then 40.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from calibration_core.cell import Cell
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.protocol import FOUR_STEPS, NINE_STEPS, Configuration, Protocol, pull, rated_force

REVERSED = (*NINE_STEPS, *(-level for level in NINE_STEPS[1:]))
TWO_STEPS = (0.0, 1.0)
LOADED, LEAST_LOADED, ABSOLUTE, BESIDES = 18, 12, 60, 36
KINDS = ("L", "R", "W", "S", "A", "LA", "RA")
ONE_POINT = frozenset("WS")
_KIND = re.compile(r"(?:([LRWS])(\d*))?(?:(A)(\d*))?")


def make_protocol(cell: Cell, kind: str, seed: int) -> Protocol:
    """Draw the configurations and loads of a protocol; the same seed gives the same one.

    Raises:
        PlanError: Too few configurations can be reached and seen.
    """
    loads, loaded, absolute, single = _parts(kind)
    parts: list[Configuration] = []
    if loads in {"L", "R", "S"}:
        levels = {"L": NINE_STEPS, "R": REVERSED, "S": TWO_STEPS}[loads]
        parts += random_protocol(cell, loaded, seed, levels=levels).configurations
    if loads == "W":
        down = pull(np.asarray(cell.gravity), rated_force(cell), FOUR_STEPS)
        drawn = random_protocol(cell, loaded, seed).configurations
        parts += [dataclasses.replace(configuration, wrenches=down) for configuration in drawn]
    if absolute:
        still = random_protocol(cell, single, seed + 1, levels=(0.0,)).configurations
        parts += [dataclasses.replace(c, number=len(parts) + c.number) for c in still]
    return Protocol(tuple(parts))


def is_loaded(kind: str) -> bool:
    """Return whether a protocol has load steps."""
    return kind[:1] in {"L", "R", "W", "S"}


def _parts(kind: str) -> tuple[str, int, bool, int]:
    """Return the letter of the loads, how many configurations have them, whether and how many have one step."""
    match = _KIND.fullmatch(kind)
    if match is None or not kind:
        msg = f"protocol {kind!r}: found no such kind, expected one of {', '.join(KINDS)}, or with numbers: L5A40"
        raise ValueError(msg)
    loads, loaded, absolute, single = match.groups()
    usual = BESIDES if loads else ABSOLUTE
    least = {"": 0, "S": LEAST_LOADED}.get(loads or "", LOADED)
    return loads or "", int(loaded or least), absolute is not None, int(single or usual)


def points_of(cell: Cell, kind: str) -> tuple[str, ...]:
    """Return the names of the points that a protocol measures."""
    names = tuple(cell.frames.measurement_points)
    return names[:1] if kind[:1] in ONE_POINT else names
