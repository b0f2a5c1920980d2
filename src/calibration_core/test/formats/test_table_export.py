"""The table of corrections: exact at its nodes, and as good between them as it says."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from export_cases import CELLS, case

from calibration_core.formats.calibrated import flange_poses
from calibration_core.formats.table import corrections
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import posture

RANGE = ("--range", "-0.2 0.9 -0.2 0.9")


def test_at_a_node_the_calibrated_robot_stands_where_the_nominal_would(tmp_path: Path) -> None:
    of = case(tmp_path, CELLS / "small.cell.yaml", effects=False)
    result = of.export(tmp_path / "out", "--format", "table", *RANGE, "--q", "0.2 0 0 0.1 0.8 -0.3")
    with (tmp_path / "out" / "corrections.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 21 * 21
    assert min(float(row["q2"]) for row in rows) == -0.2
    robot = of.robot()
    q = np.tile([0.2, 0.0, 0.0, 0.1, 0.8, -0.3], (len(rows), 1))
    q[:, 1], q[:, 2] = ([float(row[name]) for row in rows] for name in ("q2", "q3"))
    dq = np.array([[float(row[f"dq{i}"]) for i in range(1, 7)] for row in rows])
    target = flange_poses(posture(robot.nominal, q))
    before, after = (
        flange_poses(solve_equilibrium(robot.chain, one, robot.parameters.compliance, None).at) - target
        for one in (q, q + dq)
    )
    gain = np.linalg.norm(after[:, :3, 3], axis=1) / np.linalg.norm(before[:, :3, 3], axis=1)
    assert gain.max() < 1e-6
    between, left, without = result["deviations"]
    assert between["postures"] == 1000
    assert between["largest"] < 0.01 * without["rms"]
    assert left["largest"] < 0.01 * without["rms"]


def test_what_it_says_of_the_error_between_nodes_is_so(tmp_path: Path) -> None:
    """Fewer nodes, larger error: by the square of their distance, as linear interpolation has it."""
    of = case(tmp_path, CELLS / "small.cell.yaml", effects=False)
    sizes = []
    for points in ("6", "11", "21"):
        result = of.export(tmp_path / points, "--format", "table", "--points", points, *RANGE)
        sizes.append(result["deviations"][0]["rms"])
    assert sizes[0] / sizes[1] == pytest.approx(4.0, rel=0.35)
    assert sizes[1] / sizes[2] == pytest.approx(4.0, rel=0.35)


def test_near_a_singular_posture_corrections_stay_small(tmp_path: Path) -> None:
    of = case(tmp_path, CELLS / "small.cell.yaml", effects=False)
    q = np.array([[0.1, 0.2, 0.3, 0.4, 0.0, 0.6], [0.1, 0.2, 0.3, 0.4, 1e-6, 0.6]])
    assert np.abs(corrections(of.robot(), q)).max() < 0.2


@pytest.mark.parametrize(
    "arguments",
    [
        ("--joints", "2", "2"), ("--joints", "7"), ("--points", "1"), ("--points", "2000"), ("--q", "1 2 3"),
        ("--q", "a b"), ("--q", "0 0 0 0 nan 0"), ("--q", "0 0 0 0 9 0"), ("--range", "0 1"), ("--range", "1 0 0 1"),
        ("--range", "-9 0 0 1"),
    ],
)  # fmt: skip
def test_a_grid_that_does_not_fit(
    arguments: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    of = case(tmp_path, CELLS / "small.cell.yaml", effects=False)
    assert of.code(tmp_path / "out", "--format", "table", *arguments) == 2
    text = capsys.readouterr().err
    assert arguments[0] in text
    assert len(text.splitlines()) == 1
    assert not (tmp_path / "out").exists()
