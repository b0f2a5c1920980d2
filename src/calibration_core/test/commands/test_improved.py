"""The improved simulation through the program: what is handed over leaves what the steps promise."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from program import names, result_of, run

from calibration_core.cell import load_cell
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.nominal import nominal_parameters
from calibration_core.observations.observe import observe

SOFTER = [0.8, 1.2, 0.7, 0.9, 1.25, 0.8]  # of the stiffness that the cell file states


def measured(cell_path: Path, folder: Path, plan: Path, seeds: Sequence[int]) -> list[Path]:
    """Tables of a robot whose joints, frames and points are not those of the cell file."""
    content = yaml.safe_load(cell_path.read_text())
    content["robot"]["stiffness"] = [a * b for a, b in zip(content["robot"]["stiffness"], SOFTER, strict=True)]
    content["frames"]["tracker"]["xyz"][0] += 2e-3
    other = folder / "other.yaml"
    other.write_text(yaml.safe_dump(content))
    for seed in seeds:
        options = ("--cell", other, "--plan", plan, "--seed", seed, "--out", folder / str(seed), "--no-report")
        assert run("simulate", *options) == 0
    return [folder / str(seed) / "measurements.csv" for seed in seeds]


@pytest.fixture(scope="module")
def pair(planned: Path, cell_path: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The recording, and the output of its diagnosis beside a simulation."""
    folder = tmp_path_factory.mktemp("improved")
    plan, out = planned / "plan.yaml", folder / "out"
    recording, test = measured(cell_path, folder, plan, (5, 6))
    assert run("simulate", "--cell", cell_path, "--plan", plan, "--out", folder / "clean", "--no-report") == 0
    theirs = folder / "clean" / "measurements.csv"
    options = ("--cell", cell_path, "--simulation", theirs, "--test", test, "--out", out)
    assert run("diagnose", recording, *options) == 0
    return recording, out


def test_the_new_simulation_leaves_what_the_steps_promise(
    pair: tuple[Path, Path], cell_path: Path, tmp_path: Path
) -> None:
    recording, out = pair
    compared = result_of(out)["comparison"]
    last, improved = compared["steps"][-1], compared["improved"]
    assert last["name"] == "noise"
    assert improved["rms"] == pytest.approx(last["rms"], rel=0.05)
    assert improved["test_rms"] == pytest.approx(last["test_rms"], rel=0.1)
    options = ("--cell", cell_path, "--simulation", out / "simulation.csv", "--out", tmp_path / "out", "--no-report")
    assert run("diagnose", recording, *options) == 0
    again = result_of(tmp_path / "out")["comparison"]
    assert again["step_by_step"]["rms"] == pytest.approx(improved["rms"], rel=1e-3)
    assert max(step["share"] for step in again["steps"][:-1]) < 0.02


def test_the_lines_of_the_cell_file_give_the_same_simulation(pair: tuple[Path, Path], cell_path: Path) -> None:
    recording, out = pair
    assert names(out) >= {"simulation.csv", "cell_lines.yaml", "robot.urdf", "robot.xml"}
    content, lines = (yaml.safe_load(path.read_text()) for path in (cell_path, out / "cell_lines.yaml"))
    for key in ("dh", "joint_limits", "inertials"):  # the URDF stands for them
        del content["robot"][key]
    for section, values in lines.items():
        content[section] |= values
    merged = out / "merged.yaml"
    merged.write_text(yaml.safe_dump(content))
    cell = load_cell(merged)
    predicted = predict_readings(observe(recording, cell), cell, nominal_parameters(cell))
    np.testing.assert_allclose(predicted, observe(out / "simulation.csv", cell).position, atol=1e-9)
    losses = {tuple(one["files"]): one for one in result_of(out)["comparison"]["improved"]["left_out"]}
    assert losses["cell_lines.yaml", "robot.urdf"]["costs"] == 0.0
    assert losses["robot.urdf",]["effects"] == ["the springs of the joints"]
    assert losses["robot.urdf",]["costs"] > 1e-4


def test_the_answer_fits_a_terminal(pair: tuple[Path, Path]) -> None:
    lines = result_of(pair[1])["summary"]
    assert len(lines) < 12  # the report's place follows
    assert max(map(len, lines)) <= 120
    assert any("simulation.csv" in line for line in lines)
