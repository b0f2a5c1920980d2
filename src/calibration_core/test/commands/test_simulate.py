"""`calibration simulate` through the program: the recording is what the model predicts, and no other one is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from program import names, of_displacements, result_of, run

from calibration_core.cell import load_cell
from calibration_core.observations.observe import observe
from calibration_core.recording.bags import writer as bag_writer


def test_the_set_is_complete(simulated: Path) -> None:
    assert names(simulated) == {"result.json", "report.html", "report.pdf", "recording", "measurements.csv"}
    assert names(simulated / "recording") == {"metadata.yaml", "recording.mcap"}


def test_the_result_tells_what_was_simulated(simulated: Path) -> None:
    content = result_of(simulated)
    assert content["command"] == "simulate"
    assert content["recording"]["configurations"] == 12
    assert content["recording"]["loaded"] is True
    assert content["noise_seed"] == 1
    assert content["messages"]["/calibration/step"] > 12
    assert [item["role"] for item in content["input"]["sha256"]] == ["cell", "plan"]


def test_the_report_says_that_nothing_was_measured(simulated: Path) -> None:
    page = (simulated / "report.html").read_text(encoding="utf-8")
    for text in ("These are no measurements.", "Recording simulated: 324 readings", "seed 1", "6 spares"):
        assert text in page


def test_a_coupling_of_joints_is_in_what_is_written_and_not_in_what_is_read(
    planned: Path, cell_path: Path, tmp_path: Path
) -> None:
    coupled = tmp_path / "cell.yaml"
    text = cell_path.read_text(encoding="utf-8")
    coupled.write_text(
        text.replace("robot:\n", "robot:\n  joint_coupling: {joint_3: {joint_2: 1.0}}\n", 1), encoding="utf-8"
    )
    for name, path in (("plain", cell_path), ("coupled", coupled)):
        options = ("--plan", planned / "plan.yaml", "--no-report", "--out", tmp_path / name)
        assert run("simulate", "--cell", path, *options) == 0
    for file in ("recording", "measurements.csv"):
        plain, read = (
            observe(tmp_path / name / file, load_cell(path))
            for name, path in (("plain", cell_path), ("coupled", coupled))
        )
        np.testing.assert_allclose(read.q, plain.q, atol=1e-9)
        stated = observe(tmp_path / "coupled" / file, load_cell(cell_path))
        np.testing.assert_allclose(stated.q[:, 2], plain.q[:, 2] - plain.q[:, 1], atol=1e-9)


def test_without_a_plan_one_is_made_and_written(cell_path: Path, tmp_path: Path) -> None:
    assert run("simulate", "--cell", cell_path, "--out", tmp_path, "--no-report") == 0
    assert names(tmp_path) == {"result.json", "recording", "measurements.csv", "plan.yaml", "table1.csv", "table1.yaml"}
    assert result_of(tmp_path)["plan"] == "plan.yaml"
    cell = load_cell(cell_path)
    bag, table = observe(tmp_path / "recording", cell), observe(tmp_path / "measurements.csv", cell)
    assert len(bag) == len(table) == 18 * 9 * 3
    order = [np.lexsort((one.point, one.step, one.configuration)) for one in (bag, table)]
    np.testing.assert_allclose(bag.position[order[0]], table.position[order[1]], atol=1e-9)
    assert bag.wrench is not None
    assert table.wrench is not None
    np.testing.assert_allclose(bag.wrench[order[0]], table.wrench[order[1]], atol=1e-9)


def test_an_identified_model_answers_instead_of_the_cell_file(
    planned: Path, identified: Path, cell_path: Path, tmp_path: Path
) -> None:
    plan, model = planned / "plan.yaml", identified / "model.yaml"
    options = ("--cell", cell_path, "--plan", plan, "--no-report")
    assert run("simulate", *options, "--model", model, "--out", tmp_path / "a") == 0
    assert run("simulate", *options, "--out", tmp_path / "b") == 0
    written = yaml.safe_load(model.read_text())["compliance"]
    assert result_of(tmp_path / "a")["model"]["compliance"] == written
    assert (tmp_path / "a" / "measurements.csv").read_bytes() != (tmp_path / "b" / "measurements.csv").read_bytes()


def test_a_simulated_recording_is_replaced_and_a_measured_one_is_not(
    planned: Path, cell_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("simulate", "--cell", cell_path, "--plan", planned / "plan.yaml", "--out", tmp_path, "--no-report")
    assert run(*options) == 0
    before = (tmp_path / "measurements.csv").read_bytes()
    assert run(*options, "--seed", 5) == 0
    assert (tmp_path / "measurements.csv").read_bytes() != before
    assert names(tmp_path) == {"result.json", "recording", "measurements.csv"}
    (tmp_path / "result.json").write_text('{"command": "identify"}')
    after = (tmp_path / "measurements.csv").read_bytes()
    capsys.readouterr()
    assert run(*options, "--seed", 6) == 2
    assert "measurements.csv: found a file that calibration simulate did not write" in capsys.readouterr().err
    assert (tmp_path / "measurements.csv").read_bytes() == after


def test_nothing_is_left_when_the_bag_cannot_be_written(
    planned: Path, cell_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "recording_0.mcap")

    monkeypatch.setattr(bag_writer, "_write_part", full)
    options = ("--plan", planned / "plan.yaml", "--out", tmp_path / "out", "--no-report")
    assert run("simulate", "--cell", cell_path, *options) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_displacement_cells_get_both_recordings(planned: Path, cell_path: Path, tmp_path: Path) -> None:
    cell, out = of_displacements(cell_path, tmp_path), tmp_path / "out"
    assert run("simulate", "--cell", cell, "--plan", planned / "plan.yaml", "--out", out, "--no-report") == 0
    for name in ("recording", "measurements.csv"):
        target = tmp_path / name
        assert run("identify", out / name, "--cell", cell, "--out", target, "--no-report") == 0
        found = [entry["value"] for entry in result_of(target)["stiffness"]]
        np.testing.assert_allclose(found, [1.2e5, 1.5e5, 9.0e4, 2.5e4, 2.0e4, 1.2e4], rtol=1e-4)


def test_a_load_beyond_the_springs_is_refused_in_one_line(
    planned: Path, cell_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text(cell_path.read_text().replace("[1.2e+5, 1.5e+5,", "[3.0, 2.0,"))
    assert run("simulate", "--cell", cell, "--plan", planned / "plan.yaml", "--out", tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert "no static equilibrium" in error
    assert error.count("\n") == 1


def test_loads_without_stiffness_are_refused(
    planned: Path, cell_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = tmp_path / "cell.yaml"
    lines = [line for line in cell_path.read_text().splitlines() if not line.startswith("  stiffness")]
    cell.write_text("\n".join(lines))
    assert run("simulate", "--cell", cell, "--plan", planned / "plan.yaml", "--out", tmp_path / "out") == 2
    assert "robot.stiffness" in capsys.readouterr().err
