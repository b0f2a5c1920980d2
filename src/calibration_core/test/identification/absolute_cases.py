"""Robots and single-step readings for the tests of absolute recordings."""

from __future__ import annotations

from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry.fit import AbsoluteProblem
from calibration_core.model.chain import pose_matrix
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Provenance, Readings

HALF_TURN = np.pi / 2
ELBOW = (  # a, alpha, d: axes 2 and 3 parallel
    (0.33, -HALF_TURN, 0.645), (1.15, 0.0, 0.0), (0.115, -HALF_TURN, 0.0),
    (0.0, HALF_TURN, 1.22), (0.0, -HALF_TURN, 0.0), (0.0, 0.0, 0.215),
)  # fmt: skip
SEVEN = (
    (0.0, -HALF_TURN, 0.34), (0.0, HALF_TURN, 0.0), (0.045, HALF_TURN, 0.42), (-0.045, -HALF_TURN, 0.0),
    (0.0, -HALF_TURN, 0.4), (0.0, HALF_TURN, 0.0), (0.05, 0.3, 0.15),
)  # fmt: skip
MASSES = (180.0, 220.0, 120.0, 40.0, 20.0, 10.0, 5.0)
TRACKER = {"xyz": [3.1, -2.2, 1.0], "rpy": [0.02, -0.01, 2.4]}
POINTS = {"mp1": [0.11, -0.06, 0.12], "mp2": [-0.15, 0.02, 0.1], "mp3": [0.02, 0.16, 0.2]}
SIGMA = 2e-5


def make_cell(rows: tuple = ELBOW, points: tuple[str, ...] = ("mp1",), *, masses: bool = True, **changes: Any) -> Cell:
    """Return a cell with the given DH rows; `changes` replace whole sections or keys of `robot` and `frames`."""
    n = len(rows)
    robot: dict[str, Any] = {
        "name": "test robot",
        "dh": [{"a": a, "alpha": alpha, "d": d} for a, alpha, d in rows],
        "joints": [f"joint_{i + 1}" for i in range(n)],
        "joint_limits": [[-3.0, 3.0]] * n,
        "rated_load": 100.0,
    }
    if masses:
        robot["inertials"] = [
            {"mass": mass, "com": [-0.3 * row[0], 0.05, 0.02]} for mass, row in zip(MASSES, rows, strict=False)
        ]
    frames: dict[str, Any] = {"tracker": TRACKER, "measurement_points": {name: POINTS[name] for name in points}}
    robot |= changes.pop("robot", {})
    frames |= changes.pop("frames", {})
    content = {"name": "test", "robot": robot, "frames": frames, "instruments": {"tracker": {"sigma": SIGMA}}}
    return Cell.model_validate({**content, **changes})


def truth_of(cell: Cell, seed: int, *, geometry: float = 5e-4, compliance: float = 0.0) -> ModelParameters:
    """Return parameters off the nominal ones: frames by millimetres, all corrections of the geometry by `geometry`."""
    rng = np.random.default_rng(seed)
    nominal = nominal_parameters(cell)
    n = len(nominal.joints)
    tracker = pose_matrix(*(np.array(TRACKER[key]) + rng.normal(0, 2e-3, 3) for key in ("xyz", "rpy")))
    points = {name: point + rng.normal(0, 1e-3, 3) for name, point in nominal.points.items()}
    corrections = geometry * rng.standard_normal((n, 6))
    return nominal.replace(tracker=tracker, points=points, geometry=corrections, compliance=np.full(n, compliance))


def random_angles(seed: int, count: int, n: int) -> np.ndarray:
    """Return (count, n) rad, well spread."""
    return np.random.default_rng(seed).uniform(-1.6, 1.6, (count, n))


def exact_positions(cell: Cell, truth: ModelParameters, q: np.ndarray, point: str) -> np.ndarray:
    """Return (m, 3) m in the tracker frame: what an ideal tracker sees of the true robot under its own weight."""
    chain = chain_of(cell).corrected(truth.geometry)
    seen = solve_equilibrium(chain, q, truth.compliance, None).at.point(truth.points[point]).T
    return (seen - truth.tracker[:3, 3]) @ truth.tracker[:3, :3]


def make_readings(
    cell: Cell, truth: ModelParameters, q: np.ndarray, *, noise: float = SIGMA, seed: int = 0, name: str = "simulated"
) -> Readings:
    """Return one single-step configuration per row of `q`, every point of the cell read."""
    rng = np.random.default_rng(seed)
    k, m = len(cell.points), len(q)
    positions = np.stack([exact_positions(cell, truth, q, point) for point in cell.points], axis=1).reshape(-1, 3)
    return Readings(
        points=cell.points,
        configuration=np.repeat(np.arange(1, m + 1), k),
        step=np.zeros(m * k, dtype=np.int64),
        point=np.tile(np.arange(k), m),
        q=np.repeat(q, k, axis=0),
        position=positions + noise * rng.standard_normal((m * k, 3)),
        wrench=None,
        time=np.full(m * k, np.nan),
        temperature=np.full(m * k, 20.0),
        provenance=Provenance(name, "csv", {}, {}),
    )


def make_problem(cell: Cell, readings: Readings) -> AbsoluteProblem:
    """Return the least-squares problem of readings with equal isotropic noise."""
    point = readings.point if len(readings.points) > 1 else None
    position = np.ascontiguousarray(readings.position.T)
    return AbsoluteProblem(chain_of(cell), readings.q, position, readings.points, point, 1 / SIGMA)
