"""Every example in the documents runs: commands one after another, Python, YAML of cell files, notebooks."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import notebook
import pytest
import yaml
from documents import DOCUMENTS, ROOT, blocks, commands

import calibration_core as cal
from calibration_core.cli import main, parse

SMALL = ROOT / "config" / "cells" / "small.cell.yaml"
RUN = [path for path in DOCUMENTS if any(language == "console" for language, _ in blocks(path))]
PYTHON = [path for path in DOCUMENTS if any(language == "python" for language, _ in blocks(path))]
NOTEBOOKS = sorted(ROOT.glob("src/*/doc/notebooks/*.ipynb"))
LANGUAGES = {"console", "python", "sh", "text", "yaml", ""}
RESERVATION = re.compile(r"beyond the model's valid range|refused|usable with reservations|usable: no")
PLACEHOLDER = re.compile(r"[A-Z]{2,}|\.\.\.|…")  # RECORDING stands for any


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the documents' own files stand, and stand-ins for the reader's."""
    desk = tmp_path_factory.mktemp("desk")
    for name in ("bags", "config", "src"):
        (desk / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "bags" / "small_loaded", desk / "my_bag")
    assert main(["simulate", "--cell", str(SMALL), "--seed", "6", "--out", str(desk / "new"), "--no-report"]) == 0
    (desk / "new_bag").symlink_to(desk / "new" / "recording")
    shutil.copy(SMALL, desk / "my.cell.yaml")
    cell = cal.load_cell(SMALL)
    recording = cal.load_recording(ROOT / "bags" / "small_loaded", cell)
    simulated = cal.simulate(cell, seed=5, plan=cal.plan(cell, configurations=12, load_levels=(0.0, 1.0, 0.0)))
    for name, one in (("other_day.csv", simulated.recording), ("measurements.csv", recording)):
        columns = one.tables["measurements"]
        rows = zip(*columns.values(), strict=True)
        text = "\n".join([",".join(columns), *(",".join("" if v != v else str(v) for v in row) for row in rows)])
        (desk / name).write_text(f"{text}\n")
    points, robot = tables(recording)
    (desk / "points.txt").write_text(points)
    (desk / "robot.csv").write_text(robot)
    (desk / "task.csv").write_text(
        "q1,q2,q3,q4,q5,q6,fx,fy,fz,tx,ty,tz\n"
        + "".join(f"0.1,0.5,{q3},0.3,0.7,0.1,50,0,-60,0,0,1\n" for q3 in (0.2, 0.25, 0.3))
    )
    (desk / "plant.csv").write_text(
        "recording,cell,robot,type,date\n"
        "my_bag,my.cell.yaml,first,small,2026-01-05\nother_day.csv,my.cell.yaml,second,small,2026-01-06\n"
    )
    return desk


def tables(recording: cal.Recording) -> tuple[str, str]:
    """A recording as tracker software and a controller would export it: mm and degrees, in two files."""
    columns = recording.tables["measurements"]
    points, robot = (
        ["Point Name\tX [mm]\tY [mm]\tZ [mm]"],
        ["Pose;Step;" + ";".join(f"J{i + 1} [deg]" for i in range(6))],
    )
    seen = set()
    for i in range(len(recording)):
        key = f"C{columns['configuration'][i]:02d}_S{columns['step'][i]}"
        x, y, z = (f"{1e3 * columns[axis][i]:.4f}" for axis in "xyz")
        points.append(f"{key}_{columns['point'][i]}\t{x}\t{y}\t{z}")
        if key not in seen:
            angles = ";".join(f"{columns[f'q{j + 1}'][i] * 57.29577951308232:.6f}" for j in range(6))
            robot.append(f"{columns['configuration'][i]};{columns['step'][i]};{angles}")
            seen.add(key)
    return "\n".join(points) + "\n", "\n".join(robot) + "\n"


@pytest.mark.parametrize("path", RUN, ids=lambda path: path.name)
def test_commands_of_a_document_run(
    path: Path, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(desk)
    shutil.rmtree(desk / "my", ignore_errors=True)  # each document begins with a cell file of its own
    ran = [
        line
        for language, text in blocks(path)
        if language == "console"
        for line in text.splitlines()
        if line.startswith("$ ")
    ]
    assert ran
    for line in ran:
        words = shlex.split(line.removeprefix("$ "), comments=True)
        assert words[0].rpartition("/")[2] == "calibration", line
        assert main([*words[1:], *quick(words[1])]) == 0, f"{line}: {capsys.readouterr().err}"
        out = Path(parse(words[1:]).out or ".")
        assert json.loads((out / "result.json").read_text())["command"] == words[1]


def quick(command: str) -> list[str]:
    """Options that leave the report out, which other tests make."""
    drawing = {"plan", "simulate", "identify", "diagnose", "predict", "compensate", "verify", "compare", "fleet"}
    return ["--no-report"] if command in drawing else []


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_command_that_is_written_is_one(path: Path) -> None:
    for line in commands(path):
        words = shlex.split(re.sub(r"\[.*?\]", "", line))
        if any(PLACEHOLDER.search(word) for word in words):
            words = words[:2]
        if len(words) > 2 and "--help" not in words:  # a command that is only mentioned may leave out the cell
            takes_cell = words[1] in {"plan", "simulate", "identify", "diagnose", "predict"}
            parse([*words[1:], *(["--cell", "x"] if takes_cell and "--cell" not in words else [])])
        else:
            with pytest.raises(SystemExit) as ended:
                parse([*words[1:], "--help"])
            assert ended.value.code == 0, line


@pytest.mark.parametrize("path", PYTHON, ids=lambda path: path.name)
def test_python_of_a_document_runs(
    path: Path, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(desk)
    for language, text in blocks(path):
        if language == "python":
            exec(compile(text, path.name, "exec"), {})
    stated = set(RESERVATION.findall(capsys.readouterr().out))
    assert [words for words in stated if words not in path.read_text("utf-8")] == [], "the page does not speak of it"


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_yaml_and_languages_of_a_document(path: Path) -> None:
    for language, text in blocks(path):
        assert language in LANGUAGES, f"a block in {language}: nothing looks whether it is right"
        if language == "yaml":
            assert isinstance(yaml.safe_load(text.replace("...", "")), dict | list)


# The shortest in the gate; `make docs` runs all of them, and puts their outputs into the pages.
@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.slow] * (path.stem != "first_calibration")) for path in NOTEBOOKS],
    ids=lambda path: path.name,
)
def test_a_notebook_runs(path: Path) -> None:
    cells = notebook.run(path)
    shown = [cell for cell in cells if cell.html or cell.svg]
    assert len(shown) >= 2
    content = json.loads(path.read_text("utf-8"))
    assert [cell["outputs"] for cell in content["cells"] if cell["cell_type"] == "code"] == [[]] * sum(
        cell.kind == "code" for cell in cells
    ), "outputs are made when the documentation is built, and not kept"
