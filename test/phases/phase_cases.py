"""A nominal robot description and a recording of every phase of its calibration, by the simulator's own kinematics."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Readings
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.protocol import FOUR_STEPS, Configuration, Protocol
from calibration_sim.cell.table import measure, solve
from calibration_sim.cell.truth import Spread, Truth, draw_truth

CELL = load_cell(Path(__file__).parents[2] / "config/cells/demo.cell.yaml")
NOMINAL_ONLY = Spread(
    joint_zero=5e-4, joint_shift=5e-4, joint_turn=5e-4, tracker_shift=0.5, tracker_turn=0.3, point=5e-3
)
HOME = np.array([0.0, -1.1, 1.3, 0.3, 0.9, -0.2])
ARC = np.radians(170.0)
POSES = 24


def bare_cell() -> Cell:
    """Return the cell without a tracker pose."""
    return CELL.model_copy(update={"frames": CELL.frames.model_copy(update={"tracker": None})})


def arc_of(joint: int, arc: float, cell: Cell = CELL) -> np.ndarray:
    """Return the angles of one joint's sweep about its home, within its limits, rad."""
    low, high = chain_of(cell).limits[joint] + np.array([0.02, -0.02])
    middle = np.clip(HOME[joint], low + arc / 2, high - arc / 2) if high - low > arc else (low + high) / 2
    half = min(arc, high - low) / 2
    return np.linspace(middle - half, middle + half, POSES)


def kinematic_angles(seed: int, arc: float = ARC, poses: int = 20) -> np.ndarray:
    """Return (k, 6) rad: a sweep of every joint, the wrist motion, known configurations."""
    rng = np.random.default_rng(seed)
    parts = []
    for joint in range(6):
        q = np.tile(HOME, (POSES, 1))
        q[:, joint] = arc_of(joint, arc)
        parts.append(q)
    wrist = np.tile(HOME, (POSES, 1))
    wrist[:, 3:] += rng.uniform(-1.2, 1.2, (POSES, 3))
    known = rng.uniform([-1.5, -1.8, 0.6, -2.5, -1.7, -2.5], [1.5, -0.7, 2.0, 2.5, 1.7, 2.5], (poses, 6))
    return np.concatenate([*parts, wrist, known])


def protocol(seed: int, **options: float) -> Protocol:
    """Return all phases: single steps, then 18 loaded configurations of four steps."""
    free = [Configuration(k, q, np.zeros((1, 6))) for k, q in enumerate(kinematic_angles(seed, **options), start=1)]
    loaded = random_protocol(CELL, 18, seed, levels=FOUR_STEPS).configurations
    later = [dataclasses.replace(one, number=len(free) + k) for k, one in enumerate(loaded, start=1)]
    return Protocol((*free, *later))


def play(seed: int) -> tuple[Truth, Readings]:
    """Return a truth of its own and the recording of all phases."""
    truth = draw_truth(CELL, seed, spread=NOMINAL_ONLY)
    return truth, measure(solve(CELL, truth, protocol(seed)), CELL, seed)
