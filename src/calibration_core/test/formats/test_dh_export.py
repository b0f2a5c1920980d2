"""Denavit-Hartenberg rows as written, rebuilt here from the definition."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_cases import CELLS, UR_ROWS, Case, case, model_poses, write_cell

from calibration_core.files.yaml_file import read_yaml
from calibration_core.formats.dh import dh_table
from calibration_core.model.chain import pose_matrix, rotation_x, rotation_y, rotation_z

MICROMETRE = 1e-6


def screw(rotation: Any, x: float = 0.0, z: float = 0.0) -> Any:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = x, 0.0, z
    return pose


def rebuilt(folder: Path, file: str, q: Any) -> Any:
    """Flange poses from the CSV, base and flange from the YAML."""
    frames = read_yaml(folder / "dh.yaml", 1 << 20, "DH rows").data
    ends = [pose_matrix(*(np.array(frames[name][key]) for key in ("xyz", "rpy"))) for name in ("base", "flange")]
    with (folder / file).open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["joint"] for row in rows] == [row["joint"] for row in frames["standard"]]
    poses = []
    for values in q:
        here = ends[0]
        for row, value, kind in zip(rows, values, frames["joint_types"], strict=True):
            a, alpha, beta, d, theta = (float(row[key]) for key in ("a", "alpha", "beta", "d", "theta"))
            d, theta = (d + value, theta) if kind == "prismatic" else (d, theta + value)
            joint = screw(rotation_z(theta), z=d)
            link = screw(np.eye(3), x=a) @ screw(rotation_x(alpha)) @ screw(rotation_y(beta))
            here = here @ (joint @ link if file == "dh.csv" else link @ joint)
        poses.append(here @ ends[1])
    return np.array(poses)


def check(of: Case, out: Path, count: int = 1000) -> None:
    result = of.export(out, "--format", "dh")
    assert max(one["largest"] for one in result["deviations"]) < MICROMETRE
    q, expected = model_poses(of, count)
    for file in ("dh.csv", "dh_modified.csv"):
        assert np.abs(rebuilt(out, file, q) - expected).max() < MICROMETRE


@pytest.mark.parametrize("name", ["demo", "small"])
def test_rebuilt_from_the_files(name: str, tmp_path: Path) -> None:
    check(case(tmp_path, CELLS / f"{name}.cell.yaml"), tmp_path / "out")


@pytest.mark.parametrize("size", [0.0, 1e-8, 1e-5, 5e-4, 2e-2, 0.3])
def test_parallel_axes(size: float, tmp_path: Path) -> None:
    """No length runs away, however nearly parallel the axes of shoulder, elbow and wrist are."""
    of = case(tmp_path, write_cell(tmp_path, "ur", UR_ROWS), size=size, effects=False)
    check(of, tmp_path / "out", 100)
    table = dh_table(of.robot().chain)
    if size < 1e-2:
        assert max(abs(x) for row in table.rows for x in (row.a, row.d)) < 3.0
    if size <= 5e-4:
        assert [row.form for row in table.rows] == ["DH", "Hayati", "Hayati", "DH", "DH", "DH"]


def test_nominal_rows_come_back(tmp_path: Path) -> None:
    of = case(tmp_path, write_cell(tmp_path, "ur", UR_ROWS), size=0.0, effects=False)
    table = dh_table(of.robot().chain)
    for row, (a, alpha, d) in zip(table.rows, UR_ROWS, strict=True):
        assert (row.a, row.alpha, row.beta, row.d, row.theta) == pytest.approx((a, alpha, 0.0, d, 0.0), abs=1e-12)


def test_antiparallel_and_coinciding_axes(tmp_path: Path) -> None:
    rows = [(0.0, 0.0, 0.3), (0.4, math.pi, 0.1), (0.3, math.pi / 2, 0.0), (0.0, 0.0, 0.2)]
    check(case(tmp_path, write_cell(tmp_path, "odd", rows), effects=False), tmp_path / "out", 100)


def test_a_robot_on_a_rail(tmp_path: Path) -> None:
    rows = [(0.0, -math.pi / 2, 0.3), (0.2, -math.pi / 2, 0.4), (0.6, 0.0, 0.0), (0.1, -math.pi / 2, 0.0)]
    path = write_cell(tmp_path, "rail", rows, joint_types=["prismatic", "revolute", "revolute", "revolute"])
    check(case(tmp_path, path, effects=False), tmp_path / "out", 100)


def test_geometry_of_no_robot_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    of = case(tmp_path, CELLS / "small.cell.yaml", effects=False, size=50.0)
    for form in ("urdf", "dh", "mjcf", "table"):
        assert of.code(tmp_path / "out", "--format", form) == 2
        assert "corrections of at most 10 m" in capsys.readouterr().err
