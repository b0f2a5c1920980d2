"""Joints in foreign tables: which turn and which slide, in what unit, and columns that nobody understands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import RecordingError
from calibration_core.recording.foreign.direct import read_foreign
from calibration_core.recording.foreign.join import import_files
from calibration_core.recording.foreign.mapping import import_map

ROWS = 12
TRAVEL = np.linspace(-0.9, 1.4, ROWS)  # m
TURNS = np.random.default_rng(3).uniform(-1.5, 1.5, (ROWS, 7))  # rad
TURNS[:, 6] = np.linspace(-0.05, 0.06, ROWS)  # rad: it stays within 3.5 degrees
PLACES = np.random.default_rng(4).uniform(1.0, 2.0, (ROWS, 3))


def table(folder: Path, head: list[str], travel: float, turn: float, joints: int = 7) -> Path:
    """Write positions in mm beside joints in foreign units: the first one slides."""
    lines = [";".join(["Pose", "Step", "Point", *head, "X [mm]", "Y [mm]", "Z [mm]"])]
    for k in range(ROWS):
        values = [travel * TRAVEL[k], *(turn * TURNS[k, 7 - joints :][: joints - 1])]
        cells = [f"{value:.6f}" for value in (*values, *(1e3 * PLACES[k]))]
        lines.append(";".join([str(k + 1), "0", "mp1", *cells]))
    path = folder / "foreign.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def rail(tmp_path: Path) -> Cell:
    content = yaml.safe_load((Path(__file__).parents[4] / "config" / "cells" / "small.cell.yaml").read_text())
    robot = content["robot"]
    robot["dh"].insert(0, {"a": 0.0, "alpha": -1.5708, "d": 0.1})
    robot["joints"].insert(0, "rail")
    robot["joint_types"] = ["prismatic", *["revolute"] * 6]
    robot["joint_limits"].insert(0, [-1.0, 1.5])
    robot["inertials"].insert(0, {"mass": 40.0, "com": [0.0, 0.05, 0.0]})
    robot["stiffness"].insert(0, 5.0e5)
    path = tmp_path / "rail.cell.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_cell(path)


PLAIN = [f"q{i}" for i in range(1, 8)]


@pytest.mark.parametrize(
    ("head", "travel", "turn"),
    [
        (PLAIN, 1.0, 57.29577951308232), (PLAIN, 1e3, 57.29577951308232), (PLAIN, 1.0, 1.0), (PLAIN, 1e3, 1.0),
        (["q1", *(f"q{i} [deg]" for i in range(2, 8))], 1.0, 57.29577951308232),
        (["q1 [mm]", *PLAIN[1:]], 1e3, 57.29577951308232),
    ],
)  # fmt: skip
def test_a_joint_that_slides_in_the_cell_file_is_in_a_unit_of_length(
    head: list[str], travel: float, turn: float, rail: Cell, tmp_path: Path
) -> None:
    read = read_foreign(table(tmp_path, head, travel, turn), rail)
    np.testing.assert_allclose(read.q[:, 0], TRAVEL, atol=2e-6)
    np.testing.assert_allclose(read.q[:, 1:], TURNS[:, :6], atol=2e-6)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (["q1 [deg]", *PLAIN[1:]], "deg, a unit of angle, expected a unit of length"),
        ([*PLAIN[:3], "q4 [mm]", *PLAIN[4:]], "mm, a unit of length, expected a unit of angle"),
    ],
)
def test_a_unit_that_the_joint_of_the_cell_file_cannot_have(
    head: list[str], words: str, rail: Cell, tmp_path: Path
) -> None:
    with pytest.raises(RecordingError, match=words):
        read_foreign(table(tmp_path, head, 1.0, 57.29577951308232), rail)


def test_a_travel_in_no_unit_that_the_limits_allow(rail: Cell, tmp_path: Path) -> None:
    with pytest.raises(
        RecordingError, match=r"column q1: found positions up to 1\.4e\+06 without a unit, expected m, or mm"
    ):
        read_foreign(table(tmp_path, PLAIN, 1e6, 57.29577951308232), rail)


@pytest.mark.parametrize("travel", [1.0, 1e3])
def test_without_a_cell_file_a_joint_that_may_slide_or_turn_needs_a_unit(travel: float, tmp_path: Path) -> None:
    path = table(tmp_path, PLAIN, travel, 57.29577951308232)
    with pytest.raises(
        RecordingError, match=r"column q1: .* the joint may turn or slide: .*\(units: \{q1: deg\}, or m"
    ):
        import_files([path])
    how = import_map(path, {"files": [{"units": {"q1": "m" if travel == 1.0 else "mm"}}]})
    read = import_files([path], how).readings
    np.testing.assert_allclose(read.q[:, 0], TRAVEL, atol=2e-6)
    np.testing.assert_allclose(read.q[:, 1:], TURNS[:, :6], atol=2e-6)  # the unit of a travel is not theirs


def test_six_joints_that_turn_need_none(tmp_path: Path) -> None:
    """A robot of six joints whose first one turns little is read as before."""
    head = [f"q{i}" for i in range(1, 7)]
    read = import_files([table(tmp_path, head, 2.0, 57.29577951308232, joints=6)]).readings
    np.testing.assert_allclose(read.q[:, 0], np.radians(2.0 * TRAVEL), atol=2e-6)


@pytest.mark.parametrize("name", ["joint_{}_deg", "Joint {} deg", "J{}_deg", "axis_{} [deg]", "A{}/deg"])
def test_a_unit_behind_a_number_is_a_unit(name: str, tmp_path: Path) -> None:
    head = [name.format(i) for i in range(1, 7)]
    read = import_files([table(tmp_path, head, 40.0, 57.29577951308232, joints=6)]).readings
    np.testing.assert_allclose(read.q[:, 0], np.radians(40.0 * TRAVEL), atol=2e-6)


def test_columns_that_were_not_understood_are_named(tmp_path: Path) -> None:
    head = [f"lage{i}" for i in range(1, 7)]
    path = table(tmp_path, head, 40.0, 57.29577951308232, joints=6)
    with pytest.raises(RecordingError) as caught:
        import_files([path])
    text = str(caught.value)
    assert "no joint angles in any file; columns that were not understood: 'lage1' of foreign.csv, 'lage2'" in text
    assert "a map that states what they are, such as columns: {'lage1': q1}" in text
    points = tmp_path / "points.csv"
    points.write_text("Pose;Fx [N];Fy [N];Fz [N];ost;nord;hoch\n1;1;2;3;1000;2000;3000\n")
    with pytest.raises(RecordingError, match=r"no file with positions x y z; .* 'ost' of points.csv, 'nord' of"):
        import_files([points])
