"""A model file goes round: `simulate`, `predict`, `identify` and `diagnose` read what `diagnose` has written."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from program import CELL, result_of, run

from calibration_core.cell import load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.model.identified.model_file import model_dict
from calibration_core.model.nominal import nominal_parameters

STIFFNESS = np.array([1.2e5, 1.5e5, 9.0e4, 2.5e4, 2.0e4, 1.2e4])  # of the small cell
OFF_AXIS = {
    "effect": "off_axis_compliance",
    "location": {"joint": "joint_2"},
    "variant": "before",
    "parameters": {"compliance_x": 6.0e-6, "compliance_y": 3.0e-6, "compliance_xy": 1.0e-6},
}
BACKLASH = {
    "effect": "backlash",
    "location": {"joint": "joint_1"},
    "variant": "load torque, within 2 %",
    "parameters": {"clearance": 4.0e-4, "reference_torque": 60.0},
}
CREEP = {
    "effect": "creep",
    "location": {"joint": "joint_3"},
    "variant": "30 s",
    "parameters": {"creep_share": 0.2},
}
GROWTH = {
    "effect": "thermal_growth",
    "location": {"robot": "arm"},
    "variant": "uniform",
    "parameters": {"expansion": 1.2e-5},
}
DRIFT = {
    "effect": "wrench_drift",
    "location": {"sensor": "force_torque"},
    "variant": "linear in time",
    "parameters": {f"drift_{axis}": 1.0e-4 for axis in ("fx", "fy", "fz", "tx", "ty", "tz")},
}


def written(path: Path, cell_path: Path, *effects: dict[str, Any], **changes: object) -> Path:
    """Write the cell file's own model with these effects."""
    cell = load_cell(cell_path)
    content = {**model_dict(nominal_parameters(cell), cell), "effects": list(effects), **changes}
    path.write_text(yaml_text(content))
    return path


@pytest.fixture(scope="module")
def extended(cell_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("model") / "model.yaml", cell_path, OFF_AXIS)


@pytest.fixture(scope="module")
def recorded(planned: Path, extended: Path, cell_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a robot that gives way across joint 2, with noise."""
    out = tmp_path_factory.mktemp("concealed") / "out"
    options = ("--plan", planned / "plan.yaml", "--model", extended, "--seed", 3, "--no-report")
    assert run("simulate", "--cell", cell_path, *options, "--out", out) == 0
    return out


@pytest.mark.parametrize("effects", [(BACKLASH,), (CREEP, DRIFT), (GROWTH, OFF_AXIS)])
def test_what_a_model_simulates_it_predicts_and_without_its_effects_it_does_not(
    effects: tuple[dict[str, Any], ...], planned: Path, cell_path: Path, tmp_path: Path
) -> None:
    model = written(tmp_path / "model.yaml", cell_path, *effects)
    bare = written(tmp_path / "bare.yaml", cell_path)
    options = ("--plan", planned / "plan.yaml", "--model", model, "--no-report")
    assert run("simulate", "--cell", cell_path, *options, "--out", tmp_path / "out") == 0
    told = result_of(tmp_path / "out")["model"]["effects"]
    assert [effect["effect"] for effect in told] == [effect["effect"] for effect in effects]
    sizes = {}
    for recording in ("measurements.csv", "recording"):
        for name in (model, bare):
            out = tmp_path / f"{recording}-{name.stem}"
            options = ("--cell", cell_path, "--model", name, "--out", out, "--no-report")
            assert run("predict", tmp_path / "out" / recording, *options) == 0
            sizes[recording, name.stem] = result_of(out)["fit"]["max_after"]
    assert sizes["measurements.csv", "model"] < 1e-9
    assert sizes["recording", "model"] < 1e-8
    assert sizes["measurements.csv", "bare"] > 2e-5
    assert sizes["recording", "bare"] == pytest.approx(sizes["measurements.csv", "bare"], rel=1e-3)


def test_identify_with_the_known_effect_gives_the_true_stiffness(
    recorded: Path, extended: Path, cell_path: Path, tmp_path: Path
) -> None:
    options = ("identify", recorded / "measurements.csv", "--cell", cell_path)
    assert run(*options, "--out", tmp_path / "without", "--no-report") == 0
    assert run(*options, "--model", extended, "--out", tmp_path / "with") == 0
    errors, off = {}, {}
    for name in ("without", "with"):
        joints = result_of(tmp_path / name)["stiffness"]
        errors[name] = [(joint["value"] - k) / joint["std"] for joint, k in zip(joints, STIFFNESS, strict=True)]
        off[name] = [joint["value"] / k - 1 for joint, k in zip(joints, STIFFNESS, strict=True)]
    assert np.abs(off["without"]).max() > 10 * np.abs(off["with"]).max()
    assert np.abs(errors["without"]).max() < 2  # the interval includes the bias
    assert np.abs(errors["with"]).max() < 4
    beside = [one["extended"] for one in result_of(tmp_path / "without")["stiffness"]]
    assert np.all([abs(one["value"] - k) < 4 * one["std"] for one, k in zip(beside, STIFFNESS, strict=True)])
    assert "extended" not in result_of(tmp_path / "with")["stiffness"][0]
    content = result_of(tmp_path / "with")
    digest = hashlib.sha256(extended.read_bytes()).hexdigest()
    assert content["given_model"]["file"] == str(extended)
    assert content["given_model"]["sha256"] == digest
    assert [effect["effect"] for effect in content["given_model"]["effects"]] == ["off_axis_compliance"]
    assert {"role": "model", "file": str(extended), "sha256": digest} in content["input"]["sha256"]
    assert result_of(tmp_path / "without")["given_model"] is None
    assert [note["kind"] for note in content["notes"]].count("known_effects") == 1
    assert yaml.safe_load((tmp_path / "with" / "model.yaml").read_text())["effects"] == [OFF_AXIS]
    page = (tmp_path / "with" / "report.html").read_text(encoding="utf-8")
    assert "joint 2 tilts about an axis that is not its own" in page
    assert digest[:12] in page
    assert "before (given model, frames refitted)" in page


def test_the_next_diagnosis_finds_nothing_more(recorded: Path, cell_path: Path, tmp_path: Path) -> None:
    options = ("diagnose", recorded / "measurements.csv", "--cell", cell_path)
    assert run(*options, "--out", tmp_path / "first", "--no-report") == 0
    first = result_of(tmp_path / "first")
    assert first["verdict"] == "missing_physics"
    assert [finding["effect"] for finding in first["findings"]] == ["off_axis_compliance"]
    model = tmp_path / "first" / "model.yaml"
    assert run(*options, "--model", model, "--out", tmp_path / "second") == 0
    second = result_of(tmp_path / "second")
    assert (second["verdict"], second["findings"]) == ("consistent", [])
    assert second["fit"]["rms_before"] == pytest.approx(first["fit"]["rms_after"], rel=0.02)
    assert second["given_model"]["file"] == str(model)
    effects = [yaml.safe_load((tmp_path / name / "model.yaml").read_text())["effects"] for name in ("first", "second")]
    assert len(effects[0]) >= 1
    assert effects[1] == effects[0]
    assert "taken off the readings as known" in (tmp_path / "second" / "report.html").read_text(encoding="utf-8")


def test_what_is_found_next_stands_behind_what_was_given(
    planned: Path, extended: Path, cell_path: Path, tmp_path: Path
) -> None:
    both = written(tmp_path / "both.yaml", cell_path, OFF_AXIS, BACKLASH)
    options = ("--plan", planned / "plan.yaml", "--model", both, "--seed", 5, "--no-report")
    assert run("simulate", "--cell", cell_path, *options, "--out", tmp_path / "sim") == 0
    recording, out = tmp_path / "sim" / "recording", tmp_path / "out"
    assert run("diagnose", recording, "--cell", cell_path, "--model", extended, "--out", out, "--no-report") == 0
    assert [finding["effect"] for finding in result_of(out)["findings"]] == ["backlash"]
    effects = yaml.safe_load((out / "model.yaml").read_text())["effects"]
    assert effects[0] == OFF_AXIS
    assert [effect["effect"] for effect in effects[1:]] == ["backlash"]


WRONG = {
    "missing": (None, "No such file"),
    "other joints": ({"joints": ["a", "b", "c", "d", "e", "f"]}, "joints"),
    "other robot": ({"robot": "another machine"}, "another machine"),
    "no such joint": ({"effects": [{**OFF_AXIS, "location": {"joint": "joint_9"}}]}, "joint_9"),
    "no place": ({"effects": [{**OFF_AXIS, "location": {}}]}, "off_axis_compliance"),
    "no such form": ({"effects": [{**OFF_AXIS, "variant": "sideways"}]}, "sideways"),
    "parameter missing": ({"effects": [{**OFF_AXIS, "parameters": {"compliance_x": 1e-7}}]}, "compliance_y"),
    "parameter unknown": ({"effects": [{**BACKLASH, "parameters": {"clearance": 1e-4, "x": 1}}]}, "x"),
    "no torque": ({"effects": [{**BACKLASH, "parameters": {"clearance": 1e-4, "reference_torque": 0}}]}, "positive"),
    "no order": (
        {"effects": [{**OFF_AXIS, "effect": "transmission_error", "variant": "order many", "parameters": {}}]},
        "order many",
    ),
    "no side": (
        {"effects": [{**OFF_AXIS, "effect": "approach_direction", "location": {}, "parameters": {"half_width": 1}}]},
        "approach_direction",
    ),
    "other points": ({"measurement_points": {"elsewhere": [0, 0, 0.1]}}, "mp1"),
}


@pytest.mark.parametrize(
    ("name", "command"),
    [*((name, "predict") for name in WRONG), *(("no place", name) for name in ("simulate", "identify", "diagnose"))],
)
def test_a_model_that_cannot_be_used_ends_with_one_line(
    name: str,
    command: str,
    planned: Path,
    simulated: Path,
    cell_path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    changes, words = WRONG[name]
    model, out = tmp_path / "model.yaml", tmp_path / "out"
    if changes is not None:
        written(model, cell_path, **{"effects": [], **changes})
    what = ("--plan", planned / "plan.yaml") if command == "simulate" else (simulated / "measurements.csv",)
    assert run(command, *what, "--cell", cell_path, "--model", model, "--out", out) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said
    assert ("model.yaml" in said) or name == "other points"
    assert not out.exists()


WITHOUT = "the model file states no covariance: nothing that is taken from it has an interval"


@pytest.fixture(scope="module")
def bare_model(identified: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The identified model as a file that states no covariance."""
    content = yaml.safe_load((identified / "model.yaml").read_text())
    path = tmp_path_factory.mktemp("bare") / "bare.yaml"
    path.write_text(yaml_text({**content, "parameters": [], "covariance": [], "valid_range": None}))
    return path


@pytest.fixture(scope="module")
def another(planned: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated recording that the model was not identified from: the same plan, with other noise."""
    out = tmp_path_factory.mktemp("another") / "out"
    asked = ("--cell", CELL, "--plan", planned / "plan.yaml", "--seed", 2)
    assert run("simulate", *asked, "--out", out, "--no-report") == 0
    return out


@pytest.mark.parametrize(
    "command",
    [
        ("plan", "--configurations", 12),
        ("simulate",),
        ("predict", "RECORDING"),
        ("identify", "RECORDING"),
        ("diagnose", "RECORDING"),
        ("verify", "RECORDING", "--tolerance", 1e-3),
        ("deflect", "--q", "0.1 0.5 0.2 0.3 0.7 0.1", "--wrench", "50 0 -60 0 0 1"),
        ("compensate", "TASK"),
        ("export", "--format", "urdf"),
    ],
    ids=lambda command: command[0],
)
def test_every_command_says_once_and_alike_that_a_model_has_no_intervals(
    command: tuple[object, ...],
    bare_model: Path,
    identified: Path,
    planned: Path,
    another: Path,
    cell_path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    task = tmp_path / "task.csv"
    task.write_text("q1,q2,q3,q4,q5,q6,fx,fy,fz,tx,ty,tz\n0.1,0.5,0.2,0.3,0.7,0.1,50,0,-60,0,0,1\n")
    words = {"RECORDING": another / "measurements.csv", "TASK": task}
    asked = [words.get(word, word) if isinstance(word, str) else word for word in command]
    asked += [] if command[0] == "export" else ["--no-report"]
    asked += ["--plan", planned / "plan.yaml"] if command[0] == "simulate" else []
    known = ((identified / "model.yaml", 0),) if command[0] in {"predict", "deflect"} else ()
    for model, times in ((bare_model, 1), *known):
        out = tmp_path / model.stem
        capsys.readouterr()
        assert run(*asked, "--cell", cell_path, "--model", model, "--out", out) == 0, capsys.readouterr().err
        said, result = capsys.readouterr().out, json.loads((out / "result.json").read_text())
        assert said.lower().count(WITHOUT) == times, said
        stated = [
            note["text"] if isinstance(note, dict) else note
            for key in ("notes", "remarks")
            for note in result.get(key, ())
        ]
        assert sum(WITHOUT in text.lower() for text in stated) == times
