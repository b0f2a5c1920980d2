"""Cells and models to export, and the program that exports them."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.files.yaml_file import yaml_text
from calibration_core.formats.calibrated import ExportedRobot, calibrated_robot, flange_poses, random_postures
from calibration_core.model.identified.model_file import model_text, read_model
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect

CELLS = Path(__file__).parents[4] / "config" / "cells"
UR_ROWS = [(0.0, math.pi / 2, 0.1273), (-0.612, 0.0, 0.0), (-0.5723, 0.0, 0.0), (0.0, math.pi / 2, 0.163941),
           (0.0, -math.pi / 2, 0.1157), (0.0, 0.0, 0.0922)]  # fmt: skip  # the maker's published rows of a UR10
# Poses of the links in ur_description's default file of a UR10 (documented there), fixed axes.
UR_LINKS = {
    "shoulder": (0.0, 0.0, 0.1273, 0.0, 0.0, 0.0),
    "upper_arm": (0.0, 0.0, 0.0, math.pi / 2, 0.0, 0.0),
    "forearm": (-0.612, 0.0, 0.0, 0.0, 0.0, 0.0),
    "wrist_1": (-0.5723, 0.0, 0.163941, 0.0, 0.0, 0.0),
    "wrist_2": (0.0, -0.1157, 0.0, math.pi / 2, 0.0, 0.0),
    "wrist_3": (0.0, 0.0922, 0.0, math.pi / 2, math.pi, math.pi),
}
UR_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
UR_JOINTS = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]


@dataclasses.dataclass(frozen=True)
class Case:
    """A cell, a model of it, and where both stand."""

    cell_path: Path
    model_path: Path
    cell: Cell

    def robot(self) -> ExportedRobot:
        return calibrated_robot(self.cell, read_model(self.model_path, self.cell))

    def export(self, out: Path, *arguments: str) -> dict[str, Any]:
        """Run the program; return result.json."""
        assert self.code(out, *arguments) == 0
        content: dict[str, Any] = json.loads((out / "result.json").read_text())
        return content

    def code(self, out: Path, *arguments: str) -> int:
        files = ("--cell", str(self.cell_path), "--model", str(self.model_path), "--out", str(out))
        return main(["export", *files, *arguments])


def case(folder: Path, cell_path: Path, *, seed: int = 7, size: float = 5e-4, effects: bool = True) -> Case:
    """Return a cell with a model whose frames are displaced and turned by `size` (m and rad, normal)."""
    cell = load_cell(cell_path)
    parameters = nominal_parameters(cell)
    n = len(parameters.joints)
    geometry = np.random.default_rng(seed).normal(size=(n, 6)) * size
    found = (
        AppliedEffect("joint_zero_offset", {"joint": parameters.joints[1]}, "zero", {"offset": 2e-3}),
        AppliedEffect("wrist_coupling", {"joint": parameters.joints[-1]}, "linear", {"ratio": 1e-4}),
    )
    model = folder / f"{cell_path.stem}-{seed}.model.yaml"
    model.write_text(model_text(parameters.replace(geometry=geometry, effects=found if effects else ()), cell))
    return Case(cell_path, model, cell)


def write_cell(folder: Path, name: str, rows: list[tuple[float, float, float]], **robot: Any) -> Path:
    """Write a cell of DH rows (a, alpha, d)."""
    n = len(rows)
    content = {
        "name": name,
        "robot": {
            "name": name,
            "dh": [{"a": a, "alpha": alpha, "d": d} for a, alpha, d in rows],
            "joints": [f"joint_{i + 1}" for i in range(n)],
            "joint_limits": [[-3.0, 3.0]] * n,
            "rated_load": 10.0,
            "stiffness": [1e5] * n,
            **robot,
        },
        "frames": {"measurement_points": {"mp1": [0.1, 0.0, 0.05]}},
        "instruments": {"tracker": {"sigma": 2e-5}},
    }
    path = folder / f"{name}.cell.yaml"
    path.write_text(yaml_text(content))
    return path


def model_poses(of: Case, count: int = 1000) -> tuple[Any, Any]:
    """Return joint positions (count, n) and the model's flange poses there, (count, 4, 4)."""
    chain = of.robot().chain
    q = random_postures(chain, count, seed=99)
    return q, flange_poses(posture(chain, q))


def template(folder: Path, rows: dict[str, Any] | None = None, **changes: Any) -> Path:
    poses = {link: dict(zip(UR_KEYS, values, strict=True)) for link, values in (rows or UR_LINKS).items()}
    path = folder / "extracted.yaml"
    path.write_text(yaml_text({"kinematics": {**poses, "hash": "calib_123456789", **changes}}))
    return path


def ur(folder: Path, size: float = 5e-4, seed: int = 7) -> Case:
    return case(folder, write_cell(folder, "ur10", UR_ROWS), size=size, seed=seed, effects=False)
