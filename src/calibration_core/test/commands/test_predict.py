"""`calibration predict` and `calibration identify` through the program."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from program import names, of_displacements, result_of, rewritten, run


@pytest.fixture(scope="module")
def predicted(simulated: Path, identified: Path, cell_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("predict") / "out"
    model = identified / "model.yaml"
    assert run("predict", simulated / "recording", "--cell", cell_path, "--model", model, "--out", out) == 0
    return out


def test_identify_without_report(identified: Path) -> None:
    assert names(identified) == {"result.json", "table1.csv", "table2.csv", "residuals.csv", "model.yaml"}
    assert [entry["joint"] for entry in result_of(identified)["stiffness"]] == [f"joint_{i}" for i in range(1, 7)]


def test_the_set_is_complete(predicted: Path) -> None:
    assert names(predicted) == {"result.json", "report.html", "report.pdf", "predictions.csv"}


def test_table_and_result_agree(predicted: Path) -> None:
    with (predicted / "predictions.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["configuration", "step", "point", "x", "y", "z", "px", "py", "pz"]
    error = np.array([[float(row[a]) - float(row[f"p{a}"]) for a in "xyz"] for row in rows])
    content = result_of(predicted)
    assert content["command"] == "predict"
    assert content["recording"]["readings"] == len(rows)
    assert content["recording"]["loaded"] is True
    assert content["fit"]["rms_after"] == pytest.approx(float(np.sqrt(np.mean(error**2))))
    assert content["fit"]["max_after"] == pytest.approx(float(np.linalg.norm(error, axis=1).max()))
    assert content["fit"]["held_out_rms_after"] is None
    assert content["fit"]["rms_after"] < 1.2 * content["fit"]["noise"]
    assert content["deflection"]["after"]["mean"] < 5e-5
    assert [item["role"] for item in content["input"]["sha256"]] == ["recording", "recording", "cell", "model"]


def test_the_report_says_that_nothing_was_fitted(predicted: Path) -> None:
    page = (predicted / "report.html").read_text(encoding="utf-8")
    for text in ("Nothing was fitted to the recording", "Positions predicted to", "model.yaml", "Residuals per load"):
        assert text in page
    assert "left out" not in page


def test_a_cell_without_tracker_pose_has_no_error_before(
    simulated: Path, identified: Path, cell_path: Path, tmp_path: Path
) -> None:
    cell = tmp_path / "cell.yaml"
    lines = [line for line in cell_path.read_text().splitlines() if not line.startswith("  tracker: {xyz")]
    cell.write_text("\n".join(lines))
    table, model = simulated / "measurements.csv", identified / "model.yaml"
    assert run("predict", table, "--cell", cell, "--model", model, "--out", tmp_path / "out") == 0
    content = result_of(tmp_path / "out")
    assert content["fit"]["rms_before"] is None
    assert content["deflection"] is None
    assert "the cell file states no tracker pose" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def once(row: dict[str, str]) -> bool:
    """Say whether a reading is one of those that are left where every point is read at a step of its own."""
    return row["point"] == f"mp{int(row['step']) + 1}"


@pytest.mark.parametrize("keep", [lambda row: row["step"] == "1", once], ids=["single steps", "points once each"])
def test_differences_of_reference_steps_alone_are_refused(
    keep: Callable[[dict[str, str]], bool],
    simulated: Path,
    identified: Path,
    cell_path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    cell, out, model = of_displacements(cell_path, tmp_path), tmp_path / "out", identified / "model.yaml"
    still = {"x": "0", "y": "0", "z": "0"}
    table = rewritten(
        simulated / "measurements.csv", tmp_path / "some.csv", lambda row: row | still if keep(row) else None
    )
    for command, *more in (("predict",), ("verify", "--tolerance", 1e-3)):
        assert run(command, table, "--cell", cell, "--model", model, *more, "--out", out) == 2
        error = capsys.readouterr().err
        assert error.splitlines()[-1].startswith(f"{table}: step: found single steps, and positions relative to step 0")
        assert not out.exists()


def test_points_that_are_read_once_each_have_no_deflection(
    simulated: Path, identified: Path, cell_path: Path, tmp_path: Path
) -> None:
    table = rewritten(simulated / "measurements.csv", tmp_path / "some.csv", lambda row: row if once(row) else None)
    arguments = ("--cell", cell_path, "--model", identified / "model.yaml", "--no-report", "--out", tmp_path / "out")
    assert run("predict", table, *arguments) == 0
    content = result_of(tmp_path / "out")
    assert content["deflection"] is None
    assert content["fit"]["rms_after"] < 1.3 * content["fit"]["noise"]


def test_reference_steps_of_differences_are_not_counted(planned: Path, cell_path: Path, tmp_path: Path) -> None:
    cell, out = of_displacements(cell_path, tmp_path), tmp_path / "out"
    assert (
        run("simulate", "--cell", cell, "--plan", planned / "plan.yaml", "--seed", 2, "--out", out, "--no-report") == 0
    )
    table = out / "measurements.csv"
    assert run("identify", table, "--cell", cell, "--out", tmp_path / "id", "--no-report") == 0
    model = tmp_path / "id" / "model.yaml"
    assert run("predict", table, "--cell", cell, "--model", model, "--out", tmp_path / "p") == 0
    with (tmp_path / "p" / "predictions.csv").open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["step"] != "0"]
    error = np.array([[float(row[a]) - float(row[f"p{a}"]) for a in "xyz"] for row in rows])
    fit = result_of(tmp_path / "p")["fit"]
    assert fit["rms_after"] == pytest.approx(float(np.sqrt(np.mean(error**2))))
    page = (tmp_path / "p" / "report.html").read_text(encoding="utf-8")
    assert "Deflections predicted to" in page
    assert "288" in page  # readings in the tables of residuals: 12 configurations, 8 steps, 3 points
