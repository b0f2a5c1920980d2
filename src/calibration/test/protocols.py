"""Recordings that follow the protocols of CWA 17384, 7.1 to 7.5: what the cell's model predicts, with noise."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration_core.cell import load_cell
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.recording.tables.table import write_table

HOME = np.array([0.2, 0.3, 0.4, 0.3, 0.9, -0.2])
POSES = 25  # of one sweep
ARC = 2.2  # rad


@dataclasses.dataclass(frozen=True)
class Pose:
    """One configuration without load."""

    number: int
    q: np.ndarray
    steps: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((1, 6)))


def sweeps(*joints: int) -> np.ndarray:
    """(m, 6) rad: one joint after another moves alone."""
    parts = []
    for joint in joints:
        q = np.tile(HOME, (POSES, 1))
        q[:, joint] += np.linspace(-ARC / 2, ARC / 2, POSES)
        parts.append(q)
    return np.concatenate(parts)


def wrist() -> np.ndarray:
    """(m, 6) rad: the last three joints move together, the arm stands."""
    q = np.tile(HOME, (POSES, 1))
    q[:, 3:] += np.random.default_rng(6).uniform(-1.0, 1.0, (POSES, 3))
    return q


def record(path: Path, cell_file: Path, q: np.ndarray) -> Path:
    """Write a table of one unloaded step per pose."""
    cell = load_cell(cell_file)
    poses = [Pose(number, row) for number, row in enumerate(q, start=1)]
    write_table(path, simulate_plan(poses, cell, nominal_parameters(cell), seed=1))
    return path
