"""The table of corrections: exact at its nodes, and as good between them as it says."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from export_cases import CELLS, UR_ROWS, Case, case, write_cell

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


SEVEN_ROWS = [(0.0, -np.pi / 2, 0.34), (0.0, np.pi / 2, 0.0), (0.0, np.pi / 2, 0.4), (0.0, -np.pi / 2, 0.0),
              (0.0, -np.pi / 2, 0.4), (0.0, np.pi / 2, 0.0), (0.0, 0.0, 0.126)]  # fmt: skip  # LBR iiwa 7, published
RAIL_ROW = (0.0, -np.pi / 2, 0.1)


def robot_of(kind: str, folder: Path) -> Case:
    if kind == "six":
        return case(folder, write_cell(folder, "six", UR_ROWS), effects=False)
    if kind == "seven":
        return case(folder, write_cell(folder, "seven", SEVEN_ROWS), effects=False)
    types = ["prismatic", *["revolute"] * (7 if kind == "rail of seven" else 6)]
    rows = [RAIL_ROW, *(SEVEN_ROWS if kind == "rail of seven" else UR_ROWS)]
    limits = [[-8.0, 8.0], *[[-3.0, 3.0]] * (len(rows) - 1)]
    path = write_cell(folder, "rail", rows, joint_types=types, joint_limits=limits)
    return case(folder, path, effects=False)


@pytest.mark.parametrize("kind", ["six", "seven", "rail of six", "rail of seven"])
def test_however_many_joints_there_are_the_flange_stands_where_the_nominal_would(kind: str, tmp_path: Path) -> None:
    of = robot_of(kind, tmp_path)
    robot = of.robot()
    chain = robot.chain
    q = np.random.default_rng(5).uniform(0.5, 1.4, (200, chain.n)) * np.where(np.arange(chain.n) % 2, 1, -1)
    dq = corrections(robot, q)
    target = flange_poses(posture(robot.nominal, q))
    before, after = (
        np.abs(flange_poses(solve_equilibrium(chain, one, robot.parameters.compliance, None).at) - target).max(
            axis=(1, 2)
        )
        for one in (q, q + dq)
    )
    regular = after < 1e-9  # elsewhere the corrections are held back
    assert np.count_nonzero(regular) > 0.6 * len(q)
    assert after.max() < before.max()
    assert np.abs(dq).max() < 0.05
    # No other corrections do the same and are smaller, nor do they depend on where the iteration began.
    sizes = np.where(chain.prismatic, 1.0, chain.reach)
    at = posture(chain, q + dq)
    scaled = np.concatenate([at.shifts.transpose(1, 0, 2), at.spins.transpose(1, 0, 2)]) / sizes[None, :, None]
    for k in np.flatnonzero(regular):
        null = np.linalg.svd(scaled[:, :, k])[2][6:]
        assert np.abs(null @ (sizes * dq[k])).max(initial=0.0) < 1e-3 * np.linalg.norm(sizes * dq[k])


@pytest.mark.parametrize("kind", ["seven", "rail of six", "rail of seven"])
def test_a_redundant_robot_has_a_table(kind: str, tmp_path: Path) -> None:
    of = robot_of(kind, tmp_path)
    q = " ".join(["1"] * len(of.cell.robot.joints))
    result = of.export(tmp_path / "out", "--format", "table", "--q", q, "--joints", "2", "--range", "0.5 1.5")
    between, left, without = result["deviations"]
    assert between["largest"] < without["largest"]
    assert left["largest"] < without["largest"]


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3])
def test_a_redundant_robot_near_a_singular_posture(angle: float, tmp_path: Path) -> None:
    robot = robot_of("seven", tmp_path).robot()
    q = np.array([[0.1, 0.0, 0.0, angle, 0.0, angle, 0.3], [0.1, 0.8, 0.3, angle, 0.2, angle, 0.6], [angle] * 7])
    assert np.abs(corrections(robot, q)).max() < 0.2
