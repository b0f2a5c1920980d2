"""What a spreadsheet would compute is text in our tables, and numbers stay numbers."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.files.csv_cells import inert, meant
from calibration_core.recording.tables.table import read_table, write_table
from calibration_core.report.writing.tables import predictions_csv

CELL = """name: a cell
robot:
  name: a robot
  dh: [{a: 0.05, alpha: -1.5708, d: 0.4}, {a: 0.45, alpha: 0, d: 0}, {a: 0.04, alpha: 0.3, d: 0.2}]
  joints: [j1, j2, j3]
  joint_limits: [[-3, 3], [-3, 3], [-3, 3]]
  rated_load: 10
frames:
  measurement_points: {"=mp1": [0.1, 0, 0], "-mp2": [0, 0.1, 0]}
instruments:
  tracker: {sigma: 2.0e-5}
"""


@pytest.mark.parametrize("cell", ["=1+1", "+cmd", "-x", "@SUM(A1)", "\t=1", "-1-1", "+", "=", "-", "-1e5x"])
def test_formulas_are_text(cell: str) -> None:
    assert inert(cell) == f"'{cell}"
    assert meant(inert(cell)) == cell


@pytest.mark.parametrize("cell", ["-1", "+2.5e-3", "-.5", "1e5", "mp1", "", "a=b", "'quoted", "'"])
def test_all_else_stays(cell: str) -> None:
    assert inert(cell) == cell
    assert meant(inert(cell)) == cell


def test_tables_with_such_names(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(CELL, "utf-8")
    cell = load_cell(tmp_path / "cell.yaml")
    header = "configuration,step,q1,q2,q3,point,x,y,z"
    rows = [f"1,0,-0.1,0,0,{name},-1.5,0.5,0.2" for name in cell.points]
    (tmp_path / "in.csv").write_text("\n".join([header, *rows]), "utf-8")
    readings = read_table(tmp_path / "in.csv", cell)
    write_table(tmp_path / "out.csv", readings)
    written = list(csv.DictReader((tmp_path / "out.csv").read_text("utf-8").splitlines()))
    assert [row["point"] for row in written] == ["'=mp1", "'-mp2"]
    assert [row["x"] for row in written] == ["-1.5", "-1.5"]
    again = read_table(tmp_path / "out.csv", cell)
    assert np.array_equal(again.point, readings.point)
    assert np.array_equal(again.position, readings.position)
    predicted = predictions_csv(readings, readings.position).decode().splitlines()
    assert [line.split(",")[2] for line in predicted[1:]] == ["'=mp1", "'-mp2"]
