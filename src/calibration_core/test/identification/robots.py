"""A 240 kg class robot in DH form, loads and readings for the identification tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.timeseries import Provenance, Readings

STIFFNESS = [1.4e6, 4.0e6, 9.4e5, 3.6e5, 3.7e5, 3.8e5]
POINTS = {"mp1": [0.17, 0.0, 0.12], "mp2": [-0.09, 0.15, 0.12], "mp3": [-0.09, -0.15, 0.18]}
LEVELS = (0.0, 0.5, 1.0, 0.5, 0.0)


def cell_dict() -> dict:
    """Return a complete cell file as plain values."""
    rows = [
        (0.35, -1.5708, 0.75, 0.0),
        (1.25, 0, 0, -1.5708),
        (0.041, -1.5708, 0, 0),
        (0, 1.5708, 1.1, 0),
        (0, -1.5708, 0, 0),
        (0, 0, 0.23, 0),
    ]
    return {
        "name": "test cell",
        "robot": {
            "name": "240 kg class",
            "dh": [dict(zip(("a", "alpha", "d", "theta"), map(float, row), strict=True)) for row in rows],
            "joints": [f"joint_{i}" for i in range(1, 7)],
            "joint_limits": [[-3.0, 3.0]] * 6,
            "inertials": [{"mass": m, "com": [-0.2, 0.0, 0.05]} for m in (300.0, 350.0, 250.0, 60.0, 40.0, 20.0)],
            "rated_load": 240.0,
            "stiffness": [1.15 * k for k in STIFFNESS],
        },
        "frames": {
            "tracker": {"xyz": [4.0, 1.0, 1.2], "rpy": [0.01, -0.02, -2.9]},
            "force_torque": {"xyz": [0.0, 0.0, 0.06], "rpy": [0.0, 0.0, 0.3]},
            "wrench_point": [0.12, -0.08, 0.25],
            "measurement_points": POINTS,
        },
        "instruments": {
            "tracker": {"sigma": 2e-5},
            "force_torque": {"sigma_force": 1.0, "sigma_torque": 0.5},
        },
    }


def write_cell(folder: Path, **changes: dict) -> Cell:
    """Write a cell file with some sections updated, and load it."""
    content = cell_dict()
    for section, values in changes.items():
        content[section] = {**content.get(section, {}), **values}
    path = folder / "cell.yaml"
    path.write_text(yaml_text(content))
    return load_cell(path)


def loaded_readings(cell: Cell, seed: int, configurations: int = 14, noise: float = 1.0) -> Readings:
    """Return what the core's own model predicts for random configurations and pulls, with the claimed noise."""
    rng = np.random.default_rng(seed)
    chain = chain_of(cell)
    truth = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS))
    names = list(cell.points)
    rows = []
    for number in range(1, configurations + 1):
        q = rng.uniform([-1.5, -0.6, -0.6, -2, -1.5, -2], [1.5, 0.6, 0.9, 2, 1.5, 2])
        pull = rng.normal(size=6) * [1, 1, 1, 0.2, 0.2, 0.2]
        pull *= 2300 / np.linalg.norm(pull[:3])
        for step, level in enumerate(LEVELS):
            rows += [(number, step, point, q, level * pull) for point in range(len(names))]
    grid = np.array([row[:3] for row in rows])
    angles, wrench = np.stack([row[3] for row in rows]), np.stack([row[4] for row in rows])
    readings = Readings(
        points=tuple(names),
        configuration=grid[:, 0],
        step=grid[:, 1],
        point=grid[:, 2],
        q=angles,
        position=np.zeros((len(rows), 3)),
        wrench=wrench,
        time=np.arange(len(rows), dtype=float),
        temperature=np.full(len(rows), 20.4),
        provenance=Provenance("simulated.csv", "csv", {}, {}),
    )
    rest = solve_equilibrium(chain, angles, truth.compliance, load_of(readings, cell, truth))
    points = np.stack([truth.points[name] for name in names])[grid[:, 2]].T
    position = (rest.at.point(points).T - truth.tracker[:3, 3]) @ truth.tracker[:3, :3]
    position = position + noise * cell.instruments.tracker.sigma * rng.standard_normal(position.shape)
    steps, inverse = np.unique(grid[:, :2], axis=0, return_inverse=True)
    jitter = noise * rng.standard_normal((len(steps), 6)) * ([1.0] * 3 + [0.5] * 3)
    return Readings(
        **{
            **{f: getattr(readings, f) for f in readings.__dataclass_fields__},
            "position": position,
            "wrench": wrench + jitter[inverse.reshape(-1)],
        }
    )
