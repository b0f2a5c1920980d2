"""One simulated robot measured in several set-ups: tracker, targets, sensor and noise are each set-up's own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import robots
from robots import STIFFNESS, cell_dict

from calibration_core.cell import Cell, load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.identification.several.merge import members_of
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.predict import shift_by_effects
from calibration_core.identification.stiffness.problem import load_of
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.outcomes.together.prepare import Prepared, prepare
from calibration_core.timeseries import Provenance, Readings

NAMES = ("A", "B", "C")
SIGMA = (2e-5, 4e-5, 6e-5)
OFF = 3e-3  # m: how far frames and points stand from where the cell files put them


def setup(folder: Path, k: int, points: str = "absolute", sigma: float | None = None, **robot: object) -> Cell:
    """Write and load the cell file of one set-up.

    Args:
        folder: Where.
        k: Which set-up, 0 to 2.
        points: Kind of positions.
        sigma: Standard deviation that the tracker claims, m; None: the set-up's own.
        robot: Changes of the robot section.
    """
    content = cell_dict()
    content["frames"] |= {
        "tracker": {"xyz": [4.0 - k, 1.0 + 2 * k, 1.2], "rpy": [0.01, -0.02, -2.9 + k]},
        "measurement_points": {name: [x + 0.05 * k, y - 0.03 * k, z] for name, (x, y, z) in robots.POINTS.items()},
        "force_torque": {"xyz": [0.0, 0.01 * k, 0.06 + 0.02 * k], "rpy": [0.0, 0.1 * k, 0.3 + 0.5 * k]},
    }
    content["instruments"]["tracker"] = {"sigma": SIGMA[k] if sigma is None else sigma}
    content["measurements"] = {"points": points}
    content["robot"] |= robot
    path = folder / f"{NAMES[k]}.cell.yaml"
    path.write_text(yaml_text(content))
    return load_cell(path)


def truth_in(cell: Cell, seed: int, stiffness: list[float], geometry: np.ndarray) -> ModelParameters:
    """Return the true model of one set-up: frames and points a few millimetres off, the robot the same in all."""
    rng = np.random.default_rng(seed)
    nominal = nominal_parameters(cell)
    tracker = np.array(nominal.tracker)
    tracker[:3, 3] += rng.normal(0, OFF, 3)
    points = {name: point + rng.normal(0, OFF / 3, 3) for name, point in nominal.points.items()}
    return nominal.replace(tracker=tracker, points=points, compliance=1 / np.array(stiffness), geometry=geometry)


def measured(
    cell: Cell,
    k: int,
    seed: int,
    *,
    configurations: int = 14,
    rest: int = 0,
    stiffness: list[float] | None = None,
    geometry: np.ndarray | None = None,
    effects: tuple[AppliedEffect, ...] = (),
    slipped: tuple[int, float] | None = None,
    noise: float = 1.0,
) -> Readings:
    """Return what the core's own model predicts for loaded configurations and postures at rest, with noise.

    Args:
        cell: The set-up.
        k: Its number.
        seed: Of postures, loads, noise, frames and points.
        configurations: How many are loaded.
        rest: How many are at rest.
        stiffness: N*m/rad; None: that of the cell.
        geometry: (6, 6) corrections, m and rad; None: none.
        effects: What the robot and the set-up have besides.
        slipped: Configuration from which on the second target stands elsewhere, and by how much, m.
        noise: Of tracker and sensor, times the claimed one.
    """
    rng = np.random.default_rng(seed)
    truth = truth_in(cell, seed, stiffness or STIFFNESS, np.zeros((6, 6)) if geometry is None else geometry)
    rows = []
    for number, loaded in enumerate([True] * configurations + [False] * rest, start=1):
        q = rng.uniform([-1.5, -0.6, -0.6, -2, -1.5, -2], [1.5, 0.6, 0.9, 2, 1.5, 2])
        pull = rng.normal(size=6) * [1, 1, 1, 0.2, 0.2, 0.2]
        pull *= 2300 / np.linalg.norm(pull[:3])
        for step, level in enumerate(robots.LEVELS if loaded else (0.0,)):
            rows += [(number, step, point, q, level * pull) for point in range(3)]
    grid = np.array([row[:3] for row in rows])
    angles, wrench = np.stack([row[3] for row in rows]), np.stack([row[4] for row in rows])
    name = f"{NAMES[k]}.csv"
    readings = Readings(
        points=cell.points,
        configuration=grid[:, 0],
        step=grid[:, 1],
        point=grid[:, 2],
        q=angles,
        position=np.zeros((len(rows), 3)),
        wrench=wrench if configurations else None,
        time=1e5 * k + np.arange(len(rows), dtype=float),
        temperature=np.full(len(rows), 20.0 + 0.7 * k),
        provenance=Provenance(name, "csv", {name: f"{k}{seed:063d}"}, {}, f"2026-01-0{k + 1}T08:00:00"),
    )
    load = load_of(readings, cell, truth) if configurations else None
    at = solve_equilibrium(chain_of(cell).corrected(truth.geometry), angles, truth.compliance, load).at
    points = np.stack([truth.points[point] for point in cell.points])[grid[:, 2]].T
    if slipped is not None:
        points[0] += slipped[1] * ((grid[:, 0] >= slipped[0]) & (grid[:, 2] == 1))
    moved = at.point(points).T + shift_by_effects(readings, cell, truth.replace(effects=effects))
    position = (moved - truth.tracker[:3, 3]) @ truth.tracker[:3, :3]
    position = position + noise * (cell.instruments.tracker.sigma or 0.0) * rng.standard_normal(position.shape)
    if cell.measurements.points == "displacement":
        for key in {(row[0], row[2]) for row in rows}:
            own = (grid[:, 0] == key[0]) & (grid[:, 2] == key[1])
            position[own] -= position[own & (grid[:, 1] == 0)]
    if configurations:
        steps, inverse = np.unique(grid[:, :2], axis=0, return_inverse=True)
        jitter = rng.standard_normal((len(steps), 6)) * ([1.0] * 3 + [0.5] * 3)
        wrench = wrench + noise * jitter[inverse.reshape(-1)]
    return dataclasses.replace(readings, position=position, wrench=wrench if configurations else None)


def together(
    recordings: list[Readings], cells: list[Cell], options: Options | None = None, test: Readings | None = None
) -> Prepared:
    """Return recordings as `identify` and `diagnose` take them, the first of the list named first."""
    members = members_of(recordings, cells)
    order = [next(k for k, one in enumerate(members) if one.readings is readings) for readings in recordings]
    return prepare(members, order, options or Options(), test)
