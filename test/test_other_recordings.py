"""A recording of any kind tested on a recording of any kind: one robot whose second link bends, measured six times.

The simulator plays the robot; its frames and targets are off, its stiffnesses are wrong by 15 percent, its geometry is
the cell file's.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from input_cases import since_step_zero
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.files.yaml_file import yaml_text
from calibration_core.identification.stiffness.predict import predict_readings, shift_by_effects
from calibration_core.model.effects import candidates
from calibration_core.model.effects.applied import applied
from calibration_core.model.effects.state import recorded_state
from calibration_core.model.identified.model_file import read_model
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.recording.tables.table import read_table, write_table
from calibration_core.timeseries import Float2D, Readings
from calibration_sim.cell.truth import Spread, draw_truth
from calibration_sim.effects.effect import Label
from calibration_sim.effects.structure import Beam
from calibration_sim.scenarios.measure import Noise, look
from calibration_sim.scenarios.protocols import make_protocol
from calibration_sim.scenarios.world import World, play

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
SEED = 7
KNOWN_GEOMETRY = Spread(stiffness=0.15, tracker_shift=2e-3, tracker_turn=1e-4, point=2e-4)
FITTED = {"loaded": ("L18", 1), "at_rest": ("A60", 2), "mixed": ("L12A36", 3)}
OTHERS = {"loaded": ("L6", 11), "at_rest": ("A20", 12), "mixed": ("L5A15", 13)}
PARTS = {"loaded": ["loaded"], "at_rest": ["at_rest"], "mixed": ["loaded", "at_rest"]}
CONFIGURATIONS = {"loaded": {"loaded": 6}, "at_rest": {"at_rest": 20}, "mixed": {"loaded": 5, "at_rest": 15}}
SHIFTED = np.array([0.4, -1.1, 0.2])  # m
KINDS = tuple(FITTED)
LEFT = 0.75  # of the error before: at most this is left


@functools.cache
def _world() -> World:
    cell = load_cell(CELL)
    bending = Beam(Label("structure", "link_bending", {"link": "link_2"}), 1, (6e-7, 3e-7), 3e-7, 0.2)
    return World(cell, draw_truth(cell, SEED, spread=KNOWN_GEOMETRY)).with_effects(bending)


def _recorded(protocol: str, seed: int) -> Readings:
    world = _world()
    played = play(world, make_protocol(world.cell, protocol, seed))
    return look(world, played, tuple(world.cell.frames.measurement_points), Noise(), seed)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """Recordings that are fitted, `fitted_KIND`, and others, `other_KIND`, as measurement tables."""
    folder = tmp_path_factory.mktemp("recordings")
    found = {}
    for role, kinds in (("fitted", FITTED), ("other", OTHERS)):
        for kind, (protocol, seed) in kinds.items():
            path = folder / f"{role}_{kind}.csv"
            write_table(path, _recorded(protocol, seed))
            found[path.stem] = path
    return found


def _run(command: str, out: Path, *arguments: object, cell: Path = CELL) -> int:
    line = [command, *map(str, arguments), "--cell", str(cell), "--out", str(out), "--no-report"]
    return main(line)


def _refusal(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line that is said, besides how far a slow machine is."""
    (line,) = (line for line in capsys.readouterr().err.splitlines() if not line.endswith("% done)"))
    return line


def _result(out: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((out / "result.json").read_text(encoding="utf-8"))
    return content


def _parts(test: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    return {part["kind"]: part for part in test["parts"]}


@pytest.fixture(scope="module")
def diagnosed(tables: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """Diagnose, once: kind of the recording, kind of the test recording -> output folder."""
    folder = tmp_path_factory.mktemp("diagnosed")

    @functools.cache
    def found(fitted: str, other: str) -> Path:
        out = folder / f"{fitted}_{other}"
        assert _run("diagnose", out, tables[f"fitted_{fitted}"], "--test", tables[f"other_{other}"]) == 0
        return out

    return found


OFTEN = {("loaded", "at_rest"), ("at_rest", "mixed"), ("mixed", "loaded")}
PAIRS = [
    pytest.param(fitted, other, marks=[] if (fitted, other) in OFTEN else [pytest.mark.slow])
    for fitted in KINDS
    for other in KINDS
]
"""Every kind is fitted, and every kind is the other one, in `make test`; all nine pairs in `make prove`."""


@pytest.mark.parametrize(("fitted", "other"), PAIRS)
def test_what_was_hidden_improves_every_part_of_every_other_recording(
    diagnosed: Callable[[str, str], Path], tables: Mapping[str, Path], fitted: str, other: str
) -> None:
    result = _result(diagnosed(fitted, other))
    assert [(f["effect"], f["location"]) for f in result["findings"]] == [("link_bending", {"link": "link_2"})]
    test = result["test"]
    assert [part["kind"] for part in test["parts"]] == PARTS[other]
    for kind, part in _parts(test).items():
        assert part["configurations"] == CONFIGURATIONS[other][kind]
        assert part["rms"] < LEFT * part["rms_before"]
        assert part["mean"] < LEFT * part["mean_before"]
        assert part["mean"] <= part["maximum"]
        assert part["reason"] == ""
    assert test["reason"] == ""
    assert test["rms"] < LEFT * test["rms_before"]
    table = read_table(tables[f"other_{other}"], load_cell(CELL))
    assert test["readings"] == sum(part["readings"] for part in test["parts"]) == len(table)
    assert [row["file"] for row in result["input"]["sha256"] if row["role"] == "test"] == [f"other_{other}.csv"]


def _rms(values: Float2D) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _with_own_set_up(readings: Readings, cell: Cell, seen: Float2D, turned: Float2D) -> Float2D:
    """Return the errors of predicted positions with tracker pose and targets fitted, by a solver of its own.

    Args:
        readings: Postures at rest.
        cell: The cell.
        seen: (m, 3) m, predicted.
        turned: (m, 3, 3) of the flange, as the tracker sees it.
    """
    count = len(cell.points)

    def error(x: np.ndarray) -> np.ndarray:
        offset = x[6:].reshape(count, 3)[readings.point]
        moved = seen + np.einsum("mij,mj->mi", turned, offset)
        return np.asarray((readings.position - (Rotation.from_rotvec(x[3:6]).apply(moved) + x[:3])).ravel())

    found = least_squares(error, np.zeros(6 + 3 * count), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return np.asarray(found.fun).reshape(-1, 3)


def test_the_figures_are_those_of_an_independent_computation(
    diagnosed: Callable[[str, str], Path], tables: Mapping[str, Path]
) -> None:
    cell = load_cell(CELL)
    out = diagnosed("at_rest", "mixed")
    test, model = _result(out)["test"], read_model(out / "model.yaml", cell)
    readings = read_table(tables["other_mixed"], cell)
    error = readings.position - predict_readings(readings, cell, model)
    loaded = readings.configuration <= 5
    differences = np.empty((int(loaded.sum()), 3))
    key = readings.configuration[loaded] * 100 + readings.point[loaded]
    for group in np.unique(key):
        rows = np.flatnonzero(key == group)
        differences[rows] = error[loaded][rows] - error[loaded][rows].mean(axis=0)
    parts = _parts(test)
    # offsets by the weights of the instruments differ a little from plain means
    assert parts["loaded"]["rms"] == pytest.approx(_rms(differences), rel=0.03)
    still = readings.select(~loaded)
    turned = _flange_seen(still, cell, model)
    own = _with_own_set_up(still, cell, predict_readings(still, cell, model), turned)
    assert parts["at_rest"]["rms"] == pytest.approx(_rms(own), rel=1e-3)
    assert parts["at_rest"]["maximum"] == pytest.approx(float(np.linalg.norm(own, axis=1).max()), rel=1e-2)


def _flange_seen(readings: Readings, cell: Cell, model: Any) -> Float2D:
    """Return (m, 3, 3): how predicted points move per metre that their target stands elsewhere in the flange frame."""
    step = 1e-3
    columns = []
    for axis in np.eye(3):
        moved = model.replace(points={name: point + step * axis for name, point in model.points.items()})
        columns.append((predict_readings(readings, cell, moved) - predict_readings(readings, cell, model)) / step)
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("fitted", [pytest.param("loaded", marks=pytest.mark.slow), "mixed"])
def test_a_tracker_that_was_set_up_anew_spoils_no_posture_at_rest(
    diagnosed: Callable[[str, str], Path], tables: Mapping[str, Path], tmp_path: Path, fitted: str
) -> None:
    cell = load_cell(CELL)
    readings = read_table(tables["other_at_rest"], cell)
    turn = Rotation.from_rotvec([0.02, -0.3, 0.7])
    moved = dataclasses.replace(readings, position=turn.apply(readings.position.copy()) + SHIFTED)
    write_table(tmp_path / "moved.csv", moved)
    out = tmp_path / fitted
    assert _run("diagnose", out, tables[f"fitted_{fitted}"], "--test", tmp_path / "moved.csv") == 0
    test, here = (_result(one)["test"] for one in (out, diagnosed(fitted, "at_rest")))
    for key in ("rms", "mean", "rms_before", "mean_before"):
        assert _parts(test)["at_rest"][key] == pytest.approx(_parts(here)["at_rest"][key], rel=2e-3)
    assert test["own_frames"] is (fitted == "mixed")
    assert test["rms"] == test["parts"][0]["rms"]
    assert ("the tracker or the targets stand elsewhere" in test["reason"]) is (fitted == "mixed")


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_a_recording_that_was_not_fitted_is_believed(tables: Mapping[str, Path], tmp_path: Path, command: str) -> None:
    """What is left of it has the last word: the robot that was measured again has a loose joint."""
    readings = read_table(tables["other_loaded"], load_cell(CELL))
    assert readings.wrench is not None
    pushed = readings.wrench[:, :3] / np.abs(readings.wrench[:, :3]).max()
    write_table(tmp_path / "loose.csv", dataclasses.replace(readings, position=readings.position + 2e-4 * pushed**3))
    out = tmp_path / "out"
    assert _run(command, out, tables["fitted_loaded"], "--test", tmp_path / "loose.csv") == 0
    result = _result(out)
    assert result["verdict"] == "partly_explained"
    assert "which was not fitted" in result["unexplained"]["text"]
    assert result["usable"] == "with_reservations"


@pytest.mark.parametrize(
    ("fitted", "other"), [pytest.param("loaded", "at_rest", marks=pytest.mark.slow), ("mixed", "loaded")]
)
def test_identify_judges_every_part_likewise(
    tables: Mapping[str, Path], tmp_path: Path, fitted: str, other: str
) -> None:
    assert _run("identify", tmp_path, tables[f"fitted_{fitted}"], "--test", tables[f"other_{other}"]) == 0
    test = _result(tmp_path)["test"]
    parts = _parts(test)
    assert list(parts) == PARTS[other]
    for part in parts.values():
        if fitted == "at_rest":
            continue
        assert part["rms"] < 0.8 * part["rms_before"]  # the stiffness of the cell file is 15 percent wrong
        assert part["reason"] == ""


def test_what_a_recording_says_nothing_of_is_named(
    tables: Mapping[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = load_cell(CELL)
    content: dict[str, Any] = yaml.safe_load(CELL.read_text())
    del content["robot"]["stiffness"]
    content["robot"]["urdf"] = str((CELL.parent / content["robot"]["urdf"]).resolve())
    rigid = tmp_path / "rigid.cell.yaml"
    rigid.write_text(yaml_text(content))
    truth = draw_truth(cell, SEED, spread=KNOWN_GEOMETRY)
    stiff = dataclasses.replace(truth, stiffness=np.full(6, 1e12))
    world = World(cell, stiff)
    played = play(world, make_protocol(cell, "A30", 2))
    write_table(tmp_path / "still.csv", look(world, played, tuple(cell.points), Noise(), 2))
    out = tmp_path / "out"
    assert _run("diagnose", out, tmp_path / "still.csv", "--test", tables["other_mixed"], cell=rigid) == 0
    test = _result(out)["test"]
    assert _parts(test)["loaded"]["rms"] == pytest.approx(_parts(test)["loaded"]["rms_before"], rel=0.01)
    assert test["reason"].startswith("differences under load: nothing that was found in the fitted recording changes")
    assert "differences under load: 5 configurations" in capsys.readouterr().out


def test_too_few_postures_at_rest_do_not_hide_the_loaded_part(tables: Mapping[str, Path], tmp_path: Path) -> None:
    readings = read_table(tables["other_mixed"], load_cell(CELL))
    write_table(tmp_path / "few.csv", readings.select(readings.configuration <= 7))
    assert _run("diagnose", tmp_path / "out", tables["fitted_loaded"], "--test", tmp_path / "few.csv") == 0
    test = _result(tmp_path / "out")["test"]
    parts = _parts(test)
    assert parts["loaded"]["rms"] < LEFT * parts["loaded"]["rms_before"]
    assert (parts["at_rest"]["configurations"], parts["at_rest"]["rms"]) == (2, None)
    assert "found 2 configurations, expected at least 3" in parts["at_rest"]["reason"]
    assert test["rms"] == parts["loaded"]["rms"]


def _displacements(folder: Path) -> Path:
    content: dict[str, Any] = yaml.safe_load(CELL.read_text())
    content["robot"]["urdf"] = str((CELL.parent / content["robot"]["urdf"]).resolve())
    content["measurements"] = {"points": "displacement"}
    path = folder / "displacement.cell.yaml"
    path.write_text(yaml_text(content))
    return path


def test_displacements_judge_differences_alone(
    tables: Mapping[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell_path, plain = _displacements(tmp_path), load_cell(CELL)
    for name in ("fitted_loaded", "fitted_mixed", "other_at_rest"):
        write_table(tmp_path / f"{name}.csv", since_step_zero(read_table(tables[name], plain)))
    fitted = tmp_path / "fitted_loaded.csv"
    assert _run("diagnose", tmp_path / "out", fitted, "--test", tmp_path / "fitted_mixed.csv", cell=cell_path) == 0
    test = _result(tmp_path / "out")["test"]
    parts = _parts(test)
    assert parts["loaded"]["readings"] == 12 * 9 * 3
    assert parts["loaded"]["rms"] < LEFT * parts["loaded"]["rms_before"]
    assert parts["at_rest"]["rms"] is None
    assert "displacements from step 0" in test["reason"]
    capsys.readouterr()
    assert _run("diagnose", tmp_path / "no", fitted, "--test", tmp_path / "other_at_rest.csv", cell=cell_path) == 2
    line = _refusal(capsys)
    assert "other_at_rest.csv: step: found single steps" in line
    assert not (tmp_path / "no").exists()


def test_every_effect_that_loads_show_can_be_evaluated_at_rest(tables: Mapping[str, Path]) -> None:
    cell = load_cell(CELL)
    nominal, loaded = nominal_parameters(cell), read_table(tables["other_loaded"], cell)
    state = recorded_state(loaded, cell, chain_of(cell), nominal, load_of(loaded, cell, nominal))
    still = read_table(tables["other_at_rest"], cell)
    assert still.wrench is None
    offered = {(one.effect, one.variant, *map(str, one.location.values())): one for one in candidates(state)}
    assert len(offered) > 100
    for one in offered.values():
        value = np.full(len(one.parameters), 1e-9)
        model = nominal.replace(effects=(applied(one, value, state),))
        assert np.isfinite(shift_by_effects(still, cell, model)).all()


def _shuffled(readings: Readings) -> Readings:
    """Return the same readings, configurations in another order and numbered otherwise."""
    numbers = np.unique(readings.configuration)[::-1]
    parts = [np.flatnonzero(readings.configuration == number) for number in numbers]
    found = readings.select(np.concatenate(parts))
    numbered = np.repeat(np.arange(len(parts)) + 1, [len(part) for part in parts])
    return dataclasses.replace(found, configuration=numbered, time=np.full(len(found), np.nan))


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_a_recording_is_no_test_of_itself(
    tables: Mapping[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    fitted = tables["fitted_mixed"]
    readings = read_table(fitted, load_cell(CELL))
    copied, shuffled, part = (tmp_path / f"{name}.csv" for name in ("copied", "shuffled", "part"))
    shutil.copy(fitted, copied)
    write_table(shuffled, _shuffled(readings))
    write_table(part, readings.select(readings.configuration <= 9))
    for test in (fitted, copied, shuffled, part):
        capsys.readouterr()
        assert _run(command, tmp_path / "out", fitted, "--test", test) == 2
        line = _refusal(capsys)
        assert f"{test}: --test: found " in line
        assert f"readings that are those of {fitted}, which is fitted, expected a recording that is not fitted" in line
        assert not (tmp_path / "out").exists()
    several = (tables["fitted_loaded"], fitted)
    assert _run(command, tmp_path / "out", *several, "--test", copied) == 2
    assert f"those of {fitted}, which is fitted" in capsys.readouterr().err
