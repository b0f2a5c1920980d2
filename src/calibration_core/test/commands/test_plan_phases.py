"""The phases through the program: planned, simulated, identified to Table 2."""

from __future__ import annotations

from pathlib import Path

import pytest
from program import result_of, run

from calibration_core.cell import load_cell
from calibration_core.planning.plans.plan_file import read_plan

PHASES = ["base_frame", "geometry", "wrist_centre", "points", "stiffness"]


@pytest.fixture(scope="module")
def of_phases(cell_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of `plan --phases`."""
    out = tmp_path_factory.mktemp("phases") / "plan"
    options = ("--phases", "--configurations", 12, "--load-levels", 0, 0.5, 1, "--no-report")
    assert run("plan", "--cell", cell_path, *options, "--out", out) == 0
    return out


def test_from_the_plan_to_table_2(cell_path: Path, of_phases: Path, tmp_path: Path) -> None:
    common = ("--cell", cell_path, "--no-report")
    plan = read_plan(of_phases / "plan.yaml", load_cell(cell_path))
    counted = result_of(of_phases)["preparation"]
    assert list(counted) == PHASES[:-1]
    assert sum(counted.values()) == len(plan.preparation)
    where = tmp_path / "simulate"
    assert run("simulate", *common, "--plan", of_phases / "plan.yaml", "--seed", 3, "--out", where) == 0
    out = tmp_path / "identify"
    assert run("identify", where / "recording", *common, "--out", out) == 0
    found = result_of(out)
    assert [phase["phase"] for phase in found["phases"]] == PHASES
    believed = load_cell(cell_path).robot.stiffness
    assert believed is not None
    for row, value in zip(found["stiffness"], believed, strict=True):
        assert abs(1.0 / row["value"] - 1.0 / value) < 5.0 * row["std"] / row["value"] ** 2, row


@pytest.mark.parametrize("purpose", ["stiffness", "geometry"])
def test_what_is_promised_holds_with_the_phases(cell_path: Path, of_phases: Path, tmp_path: Path, purpose: str) -> None:
    common = ("--cell", cell_path, "--no-report", "--configurations", 12, "--for", purpose)
    loads, after = (("--load-levels", 0, 0.5, 1), of_phases) if purpose == "stiffness" else ((), tmp_path / "phases")
    assert run("plan", *common, *loads, "--out", tmp_path / "alone") == 0
    if purpose == "geometry":
        assert run("plan", *common, "--phases", "--out", after) == 0
    key = "geometry" if purpose == "geometry" else "expected"
    promised = [result_of(folder)[key] for folder in (tmp_path / "alone", after)]
    alone, both = (one["duration"] for one in promised)
    standstills = len(read_plan(after / "plan.yaml", load_cell(cell_path)).preparation)
    assert both["reading"] > alone["reading"] + standstills  # more than a second each
    assert both["moving"] > alone["moving"]
    assert both["total"] == pytest.approx(sum(both[part] for part in ("moving", "startup", "loading", "reading")))
    assert promised[1]["unclear_moves"] >= promised[0]["unclear_moves"]
