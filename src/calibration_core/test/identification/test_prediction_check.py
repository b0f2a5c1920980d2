"""A prediction says whether its error is what noise and the model's intervals allow, and what it shows where not."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.commands.evaluation.predict import PredictedRecording, evaluate
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.predict import from_step_zero
from calibration_core.model.chain import pose_matrix
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.observations.observe import observe
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import Readings

ROOT = Path(__file__).resolve().parents[4]


def true_model(cell: Cell, factor: float = 1.0) -> GivenModel:
    """The simulated robot, with all joints so many times as compliant; without intervals."""
    parameters = nominal_parameters(cell).replace(compliance=factor / np.array(STIFFNESS))
    return GivenModel(parameters, "model.yaml", "0" * 64)


def recorded(cell: Cell, seed: int) -> Readings:
    """Readings as the cell file says that they are recorded: positions, or differences to the first step."""
    readings = loaded_readings(cell, seed)
    if cell.measurements.points == "absolute":
        return readings
    return dataclasses.replace(readings, position=from_step_zero(readings, readings.position))


def moved(readings: Readings, shift: tuple[float, float, float], yaw: float) -> Readings:
    pose = pose_matrix(np.array(shift), np.array([0.0, 0.0, yaw]))
    return dataclasses.replace(readings, position=readings.position @ pose[:3, :3].T + pose[:3, 3])


@pytest.mark.parametrize("points", ["absolute", "displacement"])
def test_the_true_model_is_usable(tmp_path: Path, points: str) -> None:
    cell = write_cell(tmp_path, measurements={"points": points})
    answer = evaluate(cell, true_model(cell), recorded(cell, 1))
    assert isinstance(answer, PredictedRecording)
    assert answer.found.check.ratio == pytest.approx(1.0, abs=0.1)
    assert (answer.content["verdict"], answer.content["usable"]) == ("consistent", "yes")
    assert answer.summary.startswith("usable: the error is within")


def test_the_intervals_of_an_identified_model_are_taken_into_account(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    few = loaded_readings(cell, 2)
    few = few.select(np.isin(few.configuration, np.unique(few.configuration)[:4]))
    found = identify(few, cell)
    other = loaded_readings(cell, 3)
    bare = GivenModel(found.model, "model.yaml", "0" * 64)
    known = dataclasses.replace(bare, estimate=found.estimate)
    checks = []
    for given in (bare, known):
        answer = evaluate(cell, given, other)
        assert isinstance(answer, PredictedRecording)
        checks.append(answer.found.check)
    assert [one.with_intervals for one in checks] == [False, True]
    assert checks[1].ratio < checks[0].ratio
    assert checks[1].expected > checks[0].expected
    assert checks[1].consistent


def test_missing_compliance_is_a_reservation(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    content = evaluate(cell, true_model(cell, 0.7), loaded_readings(cell, 1)).content
    assert (content["verdict"], content["usable"], content["anomalies"]) == ("unexplained", "with_reservations", [])
    assert "times what the noise allows" in content["reason"]
    assert "diagnose" in content["next_step"]
    assert content["unexplained"]["significant"]


@pytest.mark.parametrize("points", ["absolute", "displacement"])
def test_a_model_that_explains_none_of_the_motion_is_of_another_robot(tmp_path: Path, points: str) -> None:
    cell = write_cell(tmp_path, measurements={"points": points})
    content = evaluate(cell, true_model(cell, 3.0), recorded(cell, 1)).content
    assert content["usable"] == "no"
    assert [one["kind"] for one in content["anomalies"]] == ["no_relation"]
    assert "the model explains nothing of the motion under load" in content["reason"]
    assert "use the model of this robot" in content["next_step"]


def test_a_model_that_is_far_worse_than_the_cell_file_is_of_another_robot(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    given = true_model(cell)
    turned = np.zeros_like(given.parameters.geometry)
    turned[1:4, 4] = 0.004
    given = dataclasses.replace(given, parameters=given.parameters.replace(geometry=turned))
    content = evaluate(cell, given, loaded_readings(cell, 1)).content
    assert (content["usable"], content["anomalies"][0]["kind"]) == ("no", "wrong_robot_file")


def test_a_tracker_that_was_set_up_anew_is_named(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    content = evaluate(cell, true_model(cell), moved(loaded_readings(cell, 1), (0.5, 0.2, 0.0), 0.3)).content
    assert content["usable"] == "with_reservations"
    assert [one["kind"] for one in content["anomalies"]] == ["tracker_moved"]
    assert "verify with --fit-tracker" in content["next_step"]


def test_input_that_is_not_what_it_claims_is_refused_as_by_identify(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 1)
    assert readings.wrench is not None
    answer = evaluate(cell, true_model(cell), dataclasses.replace(readings, wrench=-readings.wrench))
    assert isinstance(answer, Refusal)
    assert answer.content["anomalies"][0]["kind"] == "wrench_sign"
    assert answer.content["command"] == "predict"


def test_the_command_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The positions of one robot with the angles of another: nothing is predicted."""
    cell, bag = ROOT / "config" / "cells" / "small.cell.yaml", ROOT / "bags" / "small_loaded"
    first, out, table = tmp_path / "first", tmp_path / "out", tmp_path / "other.csv"
    arguments = ["--cell", str(cell), "--no-report"]
    assert main(["identify", str(bag), *arguments, "--out", str(first)]) == 0
    model = ["--model", str(first / "model.yaml")]
    assert main(["predict", str(bag), *arguments, *model, "--out", str(out)]) == 0
    assert (out / "predictions.csv").is_file()
    assert json.loads((out / "result.json").read_text())["usable"] == "yes"
    readings = observe(bag, load_cell(cell))
    q = np.random.default_rng(2).uniform(-1.5, 1.5, readings.q.shape)
    write_table(table, dataclasses.replace(readings, q=q))
    capsys.readouterr()
    assert main(["predict", str(table), *arguments, *model, "--out", str(out)]) == 0
    assert capsys.readouterr().out.startswith("not usable: ")
    assert not (out / "predictions.csv").exists()
    result = json.loads((out / "result.json").read_text())
    assert (result["usable"], result["verdict"], result["anomalies"][0]["kind"]) == ("no", "unexplained", "no_relation")
