"""Several recordings of one robot on the command line: one result, one model, one report."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from program import CELL, WRENCH, names, result_of, rewritten, run, scaled

import calibration_core as cal
from calibration_core.files.yaml_file import read_yaml, yaml_text
from calibration_core.library.recordings import Recording
from calibration_core.recording.tables.table import write_table


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cell file of a later set-up: tracker and targets elsewhere."""
    content = read_yaml(CELL, 1 << 18, "cell").data
    content["frames"]["tracker"]["xyz"][0] += 0.4
    points = content["frames"]["measurement_points"]
    content["frames"]["measurement_points"] = {name: [x, y + 0.02, z] for name, (x, y, z) in points.items()}
    urdf = content["robot"].get("urdf")
    if urdf is not None:
        content["robot"]["urdf"] = str((CELL.parent / urdf).resolve())
    path = tmp_path_factory.mktemp("moved") / "moved.cell.yaml"
    path.write_text(yaml_text(content))
    return path


@pytest.fixture(scope="module")
def later(planned: Path, moved: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in the later set-up."""
    out = tmp_path_factory.mktemp("later")
    arguments = ("--cell", moved, "--plan", planned / "plan.yaml", "--seed", 7, "--no-report", "--out", out / "made")
    assert run("simulate", *arguments) == 0
    return out / "made"


@pytest.fixture(scope="module")
def found(simulated: Path, later: Path, moved: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of `identify` on a table and a bag of two set-ups, report included."""
    out = tmp_path_factory.mktemp("several") / "out"
    recordings = (simulated / "measurements.csv", later / "recording")
    assert run("identify", *recordings, "--cell", CELL, "--cell", moved, "--out", out) == 0
    return out


def intervals(result: dict) -> dict[str, float]:
    return {row["joint"]: row["interval_95"][1] - row["interval_95"][0] for row in result["stiffness"]}


def test_one_result_of_two_recordings(found: Path, identified: Path, simulated: Path) -> None:
    assert {"result.json", "model.yaml", "table2.csv", "report.html", "report.pdf"} <= names(found)
    result = result_of(found)
    assert result["recording"]["file"] == str(simulated / "measurements.csv")
    first, second = result["recordings"]
    assert first == result["recording"]
    assert {first["number"], second["number"]} == {1, 2}
    assert first["configurations"] == second["configurations"] == 12
    assert first["tracker"]["xyz"][0] + 0.4 == pytest.approx(second["tracker"]["xyz"][0], abs=1e-3)
    assert result["agreement"]["agree"] is True
    assert len(result["agreement"]["compared"]) == len(result["stiffness"])
    alone = intervals(result_of(identified))
    assert all(width < alone[joint] for joint, width in intervals(result).items())
    shown = (found / "report.html").read_text(encoding="utf-8")
    assert "Recordings evaluated together" in shown
    assert "the recordings agree" in shown
    assert "Joint stiffness by recording" in shown


def test_the_model_is_read_as_any_other(
    found: Path, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = simulated / "measurements.csv"
    assert run("predict", table, "--cell", CELL, "--model", found / "model.yaml", "--out", tmp_path / "p") == 0
    fit = result_of(tmp_path / "p")["fit"]
    assert fit["rms_after"] < 1.3 * fit["noise"]
    assert run("compare", found, table, "--cell", CELL, "--no-report", "--out", tmp_path / "c") == 0
    assert result_of(tmp_path / "c")["measurements"][0]["configurations"] == 24
    capsys.readouterr()
    assert run("describe", found) == 0
    text = capsys.readouterr().out
    assert "agreement: the recordings agree in " in text
    assert str(table) in text


def test_the_library_says_the_same(found: Path, simulated: Path, later: Path, moved: Path) -> None:
    first = cal.load_recording(simulated / "measurements.csv", cal.load_cell(CELL))
    second = cal.load_recording(later / "recording", cal.load_cell(moved))
    result = cal.identify([first, second])
    expected = [row["value"] for row in result_of(found)["stiffness"]]
    np.testing.assert_allclose(result.stiffness, expected, rtol=1e-12)
    with pytest.raises(cal.InputError, match="at least one"):
        cal.identify([])


def test_a_reading_is_taken_back_by_the_name_it_has_in_the_result(
    simulated: Path, later: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings = (simulated / "measurements.csv", later / "measurements.csv")
    arguments = (*recordings, "--cell", CELL, "--no-report", "--json", "--out", tmp_path / "out")
    assert run("identify", *arguments, "--readmit", "1001:1:mp1@2") == 0
    assert len(json.loads(capsys.readouterr().out)["recordings"]) == 2
    assert run("identify", *arguments, "--readmit", "1:1:mp1") == 2
    assert "1003:1:mp1@2" in capsys.readouterr().err


def test_one_diagnosis_of_two_recordings(
    simulated: Path, later: Path, moved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings = (simulated / "measurements.csv", later / "recording")
    cells, out = ("--cell", CELL, "--cell", moved), tmp_path / "out"
    assert run("diagnose", *recordings, *cells, "--out", out) == 0
    result = result_of(out)
    assert (result["verdict"], result["findings"], result["anomalies"]) == ("consistent", [], [])
    assert [one["file"] for one in result["recordings"]] == [str(path) for path in recordings]
    assert result["agreement"]["agree"] is True
    assert "agreement: the recordings agree" in capsys.readouterr().out
    assert "Recordings evaluated together" in (out / "report.html").read_text(encoding="utf-8")
    first, second = (
        cal.load_recording(path, cal.load_cell(cell)) for path, cell in zip(recordings, cells[1::2], strict=True)
    )
    together = cal.diagnose([first, second])
    assert together.verdict == "consistent"
    table, model = simulated / "measurements.csv", out / "model.yaml"
    assert run("predict", table, "--cell", CELL, "--model", model, "--no-report", "--out", tmp_path / "p") == 0
    fit = result_of(tmp_path / "p")["fit"]
    assert fit["rms_after"] < 1.3 * fit["noise"]


def test_of_recordings_that_share_no_parameter_nobody_says_that_they_agree(
    simulated: Path, later: Path, moved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Twelve postures at rest show no stiffness, and no geometry that both recordings fit alike."""
    tables, cells = (tmp_path / "a.csv", tmp_path / "b.csv"), ("--cell", CELL, "--cell", moved)
    for made, cell, table in zip((simulated, later), cells[1::2], tables, strict=True):
        readings = cal.load_recording(made / "measurements.csv", cal.load_cell(cell)).readings
        write_table(table, readings.select(readings.step == 0))
    out = tmp_path / "out"
    assert run("diagnose", *tables, *cells, "--no-report", "--out", out) == 0
    assert run("describe", out) == 0
    assert result_of(out)["agreement"] == {"agree": None, "compared": [], "differences": [], "taken_off": []}
    said = "agreement: cannot tell, no parameter of the robot is known from two of the recordings"
    assert capsys.readouterr().out.count(said) == 2


def test_every_recording_is_compared_with_its_own_simulation(
    simulated: Path, later: Path, moved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings = (simulated / "measurements.csv", later / "measurements.csv")
    cells = ("--cell", CELL, "--cell", moved)
    sims = tuple(argument for path in recordings for argument in ("--simulation", path))
    out = tmp_path / "out"
    assert run("diagnose", *recordings, *cells, *sims, "--out", out) == 0
    result = result_of(out)
    assert result["comparison"] == result["comparisons"][0]
    assert [one["recording"] for one in result["comparisons"]] == [str(path) for path in recordings]
    assert max(one["step_by_step"]["rms"] for one in result["comparisons"]) < 1e-12
    assert (result["verdict"], result["anomalies"]) == ("consistent", [])
    files = [one["file"] for one in result["input"]["sha256"] if one["role"] == "simulation"]
    assert len(files) == 2
    shown, text = (out / "report.html").read_text(encoding="utf-8"), " ".join(capsys.readouterr().out.split())
    for path in recordings:
        assert f"{path} and its simulation" in shown
        assert f"simulation of {path}: The core's model reproduces" in text
    first, second = (
        cal.load_recording(path, cal.load_cell(cell)) for path, cell in zip(recordings, cells[1::2], strict=True)
    )
    alone = cal.diagnose([first, second], simulation=first)
    assert [one.recording for one in alone.diagnosis.comparisons] == [str(recordings[0])]
    with pytest.raises(cal.InputError, match="2 simulations, expected 1 at most"):
        cal.diagnose(first, simulation=[first, second])


def test_a_fault_of_a_simulation_stands_beside_its_recording(
    simulated: Path, later: Path, moved: Path, tmp_path: Path
) -> None:
    recordings = (simulated / "measurements.csv", later / "measurements.csv")
    first, second = (
        cal.load_recording(path, cal.load_cell(cell)) for path, cell in zip(recordings, (CELL, moved), strict=True)
    )
    turned = dataclasses.replace(second.readings, wrench=-np.array(second.readings.wrench))
    other = Recording(turned, second.cell)
    found = cal.diagnose([first, second], simulation=[first, other]).diagnosis
    assert [one.differences for one in found.comparisons[:1]] == [()]
    (difference,) = found.comparisons[1].differences
    assert (difference.kind, difference.side) == ("wrench_sign", "simulation")
    assert (found.verdict, found.anomalies) == ("consistent", ())


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_a_recording_that_is_mixed_up_is_named(
    command: str, simulated: Path, later: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    other = rewritten(later / "measurements.csv", tmp_path / "turned.csv", lambda row: scaled(row, WRENCH, -1.0))
    arguments = (simulated / "measurements.csv", other, "--cell", CELL, "--no-report", "--out", out)
    assert run(command, *arguments) == 0
    result = result_of(out)
    assert (result["usable"], result["recording"]["file"], result["stiffness"]) == ("no", str(other), [])
    (anomaly,) = result["anomalies"]
    assert anomaly["location"] == {"sensor": "sensor", "recording": str(other)}
    assert f"not usable: in {other}, turn the sign of all forces" in " ".join(capsys.readouterr().out.split())


def test_more_simulations_than_recordings_are_refused(
    simulated: Path, later: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = simulated / "measurements.csv"
    sims = ("--simulation", table) * 3
    arguments = (table, later / "measurements.csv", "--cell", CELL, *sims, "--out", tmp_path / "out")
    assert run("diagnose", *arguments) == 2
    error = capsys.readouterr().err
    assert "simulation: found 3 simulations, expected 2 at most" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("cells", "text"), [(3, "3 cell files, expected one for all, or 2"), (0, "--cell: found nothing, expected a value")]
)
def test_as_many_cell_files_as_recordings_or_one(
    cells: int, text: str, simulated: Path, later: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings = (simulated / "measurements.csv", later / "measurements.csv")
    arguments = ("identify", *recordings, *(("--cell", CELL) * cells), "--out", tmp_path / "out")
    if cells == 0:
        with pytest.raises(SystemExit) as ended:
            run(*arguments)
        assert ended.value.code == 2
    else:
        assert run(*arguments) == 2
    error = capsys.readouterr().err.strip()
    assert text in error
    assert "\n" not in error
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def whole(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of `identify` on the whole table."""
    out = tmp_path_factory.mktemp("whole") / "out"
    assert run("identify", simulated / "measurements.csv", "--cell", CELL, "--no-report", "--out", out) == 0
    return out


def halves(table: Path, folder: Path, first: Callable[[int], bool], renumber: int = 0) -> tuple[Path, Path]:
    """Write a table as two files: configurations of which `first` is true, and the others with other numbers."""
    lines = table.read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("configuration,"))
    place = lines[head].split(",").index("configuration")
    rows = [line.split(",") for line in lines[head + 1 :]]
    found = []
    for name, which in (("a", True), ("b", False)):
        mine = [row for row in rows if first(int(row[place])) == which]
        if not which:
            mine = [[str(int(x) - renumber) if k == place else x for k, x in enumerate(row)] for row in mine]
        path = folder / f"{name}.csv"
        path.write_text("\n".join([*lines[: head + 1], *(",".join(row) for row in mine)]) + "\n")
        found.append(path)
    return found[0], found[1]


@pytest.mark.parametrize("split", ["halves", "every other one", "numbered alike"])
def test_files_of_one_set_up_are_one_file(split: str, simulated: Path, whole: Path, tmp_path: Path) -> None:
    first = (lambda n: n % 2 == 1) if split == "every other one" else (lambda n: n <= 9)
    parts = halves(simulated / "measurements.csv", tmp_path, first, 9 if split == "numbered alike" else 0)
    arguments = (*parts, "--cell", CELL, "--same-setup", "--no-report", "--out", tmp_path / "out")
    assert run("identify", *arguments) == 0
    one, two = result_of(whole), result_of(tmp_path / "out")
    assert two["verdict"] == one["verdict"]
    for figure in ("rms_before", "rms_after", "held_out_rms_after"):
        assert two["fit"][figure] == pytest.approx(one["fit"][figure], rel=1e-6)
    assert two["fit"]["held_out_freedom"] == one["fit"]["held_out_freedom"] == 3 * (324 - 12 * 3)  # less the offsets
    for mine, theirs in zip(two["stiffness"], one["stiffness"], strict=True):
        assert mine["value"] == pytest.approx(theirs["value"], rel=1e-6)
        assert mine["std"] == pytest.approx(theirs["std"], rel=1e-6)
    assert "recordings" not in two
    renumbered = [note for note in two["notes"] if note["kind"] == "renumbered"]
    assert len(renumbered) == (split == "numbered alike")


@pytest.mark.parametrize(
    ("more", "found"),
    [
        ((), "--same-setup: found one recording, expected several, measured in one set-up"),
        (("again",), "readings that are those of"),
        (("b", "--cell"), "--same-setup: found 2 cell files, expected one, which files of one set-up share"),
    ],
)
def test_what_one_set_up_cannot_be(
    more: tuple[str, ...], found: str, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parts = halves(simulated / "measurements.csv", tmp_path, lambda n: n <= 9)
    named = {"again": (parts[0],), "b": (parts[1],), "--cell": ("--cell", CELL)}
    arguments = (parts[0], *(x for one in more for x in named[one]), "--cell", CELL, "--same-setup")
    for command in ("identify", "diagnose"):
        assert run(command, *arguments, "--out", tmp_path / "out") == 2
        assert found in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
