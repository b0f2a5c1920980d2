"""From a simulated cell to a certificate, with the programs that a user types."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration_core.cell import load_cell
from calibration_sim.cell.configurations import random_protocol

ROOT = Path(__file__).parents[1]
CELL = ROOT / "config/cells/demo.cell.yaml"


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run one of the installed programs beside this interpreter."""
    program, *rest = map(str, arguments)
    path = Path(sys.executable).with_name(program)
    return subprocess.run([path, *rest], capture_output=True, text=True, check=False, cwd=ROOT)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a bag, a table and the hidden truth of one simulated measurement."""
    folder = tmp_path_factory.mktemp("cell")
    done = run(
        "calibration-sim", "record", "--cell", CELL, "--seed", 5, "--configurations", 12, "--imperfect",
        "--out", folder / "bag", "--table", folder / "table.csv", "--truth-out", folder / "truth.yaml",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def identified(recorded: Path) -> dict[str, Path]:
    """Return the outputs of `identify` for the bag and for the table."""
    outputs = {}
    for source in ("bag", "table.csv"):
        out = recorded / "identified" / source
        report = () if source == "bag" else ("--no-report",)
        done = run("calibration", "identify", recorded / source, "--cell", CELL, "--out", out, *report)
        assert done.returncode == 0, done.stderr
        assert all(line.endswith("% done)") for line in done.stderr.splitlines())  # progress, where it takes long
        assert (str(out / "report.html") in done.stdout) == (source == "bag")
        outputs[source] = out
    return outputs


@pytest.mark.parametrize("source", ["bag", "table.csv"])
def test_the_hidden_stiffness_is_found(recorded: Path, identified: dict[str, Path], source: str) -> None:
    out = identified[source]
    result = json.loads((out / "result.json").read_text())
    truth = yaml.safe_load((recorded / "truth.yaml").read_text())["stiffness"]
    assert result["schema"] == 1
    assert result["command"] == "identify"
    assert result["recording"]["configurations"] == 12
    assert result["recording"]["steps"] == 108
    assert result["recording"]["loaded"] is True
    for joint in result["stiffness"]:
        assert joint["identifiable"]
        # frames are refitted; sensor mounting and geometry stay wrong, so allow for more than the noise alone
        assert abs(joint["value"] - truth[joint["joint"]]) < 5 * joint["std"] + 0.01 * truth[joint["joint"]]
    assert result["fit"]["rms_after"] < 2.5e-5 < result["fit"]["rms_before"]
    for name in ("table1.csv", "table2.csv", "model.yaml"):
        assert (out / name).stat().st_size > 0
    assert source != "bag" or (out / "report.pdf").read_bytes().startswith(b"%PDF")
    with (out / "table2.csv").open() as file:
        assert len(list(csv.reader(file))) == 7


def test_the_identified_model_predicts_another_recording(
    recorded: Path, identified: dict[str, Path], tmp_path: Path
) -> None:
    """The same cell in other configurations under other pulls: how far the load moves each point, to its noise."""
    cell = load_cell(CELL)
    other = random_protocol(cell, 5, 77)
    plan = [
        {"number": 101 + k, "q": c.q.tolist(), "steps": c.wrenches.tolist()} for k, c in enumerate(other.configurations)
    ]
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump({"configurations": plan}))
    done = run(
        "calibration-sim", "record", "--cell", CELL, "--seed", 5, "--imperfect", "--plan", tmp_path / "plan.yaml",
        "--out", tmp_path / "bag", "--table", tmp_path / "table.csv",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    done = run(
        "calibration", "predict", tmp_path / "bag", "--cell", CELL, "--model", identified["table.csv"] / "model.yaml",
        "--out", tmp_path / "b", "--no-report",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with (tmp_path / "b/predictions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 * 9 * 3
    assert list(rows[0]) == ["configuration", "step", "point", "x", "y", "z", "px", "py", "pz"]
    assert {int(row["configuration"]) for row in rows} == {101, 102, 103, 104, 105}
    measured, predicted = (_moved_by_the_load(rows, prefix) for prefix in ("", "p"))
    assert np.sqrt(np.mean(measured**2)) > 4e-4
    noise = float(cell.instruments.tracker.sigma or 0.0) * np.sqrt(2.0)  # two readings each
    assert np.sqrt(np.mean((measured - predicted) ** 2)) < 1.3 * noise
    assert np.abs(measured - predicted).max() < 6.0 * noise


def _moved_by_the_load(rows: list[dict[str, str]], prefix: str) -> np.ndarray:
    """Return how far every reading of a loaded step lies from that of step 0, (k, 3) m."""
    place = {
        (row["configuration"], row["step"], row["point"]): np.array([float(row[prefix + axis]) for axis in "xyz"])
        for row in rows
    }
    return np.array([at - place[c, "0", point] for (c, step, point), at in place.items() if step != "0"])
