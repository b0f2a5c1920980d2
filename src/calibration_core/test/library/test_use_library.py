"""What the library offers to put a result to use does what the commands do, and says no as they do."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calibration_core as cal
from calibration_core.cli import main

ROOT = Path(__file__).resolve().parents[4]
BAG = ROOT / "bags" / "small_loaded"
CELL = ROOT / "config" / "cells" / "small.cell.yaml"
Q = [0.1, 0.5, 0.2, 0.3, 0.7, 0.1]
PULL = [50.0, 0.0, -60.0, 0.0, 0.0, 1.0]
TASK = (
    "q1,q2,q3,q4,q5,q6,fx,fy,fz,tx,ty,tz,path\n"
    "0.1,0.5,0.2,0.3,0.7,0.1,50,0,-60,0,0,1,a\n"
    "0.12,0.5,0.2,0.3,0.7,0.1,50,0,-60,0,0,1,a\n"
    "0.1,0.5,0.2,0.3,0.0,0.1,50,0,-60,0,0,1,\n"
)


@pytest.fixture(scope="module")
def folder(identified: cal.IdentificationResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return identified.save(tmp_path_factory.mktemp("identified"), report=False).parent


@pytest.fixture(scope="module")
def other(cell: cal.Cell, plan: cal.PlanResult, identified: cal.IdentificationResult) -> cal.Recording:
    """Another measurement of the identified robot."""
    return cal.simulate(cell, plan=plan, model=identified, seed=5).recording


def same(result: Any, folder: Path, *command: object) -> None:
    """See that saving a result writes, file by file, what a command writes."""
    report = [] if command[0] == "export" else ["--no-report"]
    assert main([*map(str, command), "--cell", str(CELL), *report, "--out", str(folder / "command")]) == 0
    path = result.save(folder / "library", **({} if command[0] == "export" else {"report": False}))
    written = {file.name: file.read_bytes() for file in (folder / "command").iterdir()}
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == written
    assert result.to_dict()["command"] == command[0]
    for table in result.tables.values():
        assert len({len(column) for column in table.values()}) == 1
    assert result.summary == repr(result)
    assert "<tr>" in result._repr_html_()


def test_compensate(cell: cal.Cell, folder: Path, identified: cal.IdentificationResult, tmp_path: Path) -> None:
    task, model = tmp_path / "task.csv", folder / "model.yaml"
    task.write_text(TASK)
    found = cal.compensate(cell, model, task)
    same(found, tmp_path, "compensate", task, "--model", model)
    assert found.ok.tolist() == [True, True, False]
    assert found.status[2] == "near a singularity"
    again = cal.compensate(cell, identified, [Q, [0.12, *Q[1:]]], PULL, one_path=True)
    np.testing.assert_allclose(again.q, found.q[:2], atol=1e-12)
    np.testing.assert_allclose(again.u95, found.u95[:2])
    assert np.all(again.error_before > again.u95)
    timed = tmp_path / "timed.csv"
    timed.write_text("q1,q2,q3,q4,q5,q6,time\n0.1,0.5,0.2,0.3,0.7,0.1,0\n0.5,0.5,0.2,0.3,0.7,0.1,1\n")
    with pytest.raises(cal.InputError, match=r"timed\.csv: line 3: found .* mm/s"):
        cal.compensate(cell, model, timed)
    each = cal.compensate(cell, identified, [Q, Q], [PULL, [0.0] * 6])
    np.testing.assert_allclose(each.q[0], found.q[0], atol=1e-9)
    assert np.abs(each.q[1] - each.q[0]).max() > 1e-6
    assert again.plot()._repr_svg_().startswith("<?xml")
    assert {"compensated.csv", "report.pdf"} < set(again.files())


def test_deflect(cell: cal.Cell, folder: Path, identified: cal.IdentificationResult, tmp_path: Path) -> None:
    poses, model = tmp_path / "poses.csv", folder / "model.yaml"
    poses.write_text("q1,q2,q3,q4,q5,q6\n" + ",".join(map(str, Q)) + "\n")
    found = cal.deflect(cell, model, poses, PULL)
    same(found, tmp_path, "deflect", "--poses", poses, "--model", model, "--wrench", " ".join(map(str, PULL)))
    again = cal.deflect(cell, identified, Q, PULL)
    np.testing.assert_allclose(again.moved, found.moved, atol=1e-15)
    assert again.points == ("tool", "mp1", "mp2", "mp3")
    assert again.moved.shape == again.u95.shape == (1, 4, 6)
    stiffness, directions = again.stiffness
    assert np.all(np.diff(stiffness) > 0)
    np.testing.assert_allclose(directions[0] @ directions[0].T, np.eye(3), atol=1e-12)
    heavier = cal.deflect(cell, identified, Q, PULL, payload=[2.0, 0.0, 0.0, 0.1], plane="xy")
    assert np.abs(heavier.moved - again.moved).max() > 0
    with pytest.raises(cal.InputError, match="row 1: found load beyond the rated load"):
        cal.deflect(cell, identified, Q, PULL, payload=[5.0, 0.0, 0.0, 0.1])
    assert heavier.plot()._repr_svg_().startswith("<?xml")


def test_verify(
    cell: cal.Cell,
    folder: Path,
    plan: cal.PlanResult,
    written: Path,
    identified: cal.IdentificationResult,
    other: cal.Recording,
    tmp_path: Path,
) -> None:
    table, model = written, folder / "model.yaml"
    found = cal.verify(cal.load_recording(table, cell), model, 5e-3)
    same(found, tmp_path, "verify", table, "--model", model, "--tolerance", 5e-3)
    assert found.decision == "conforming"
    assert found.error.shape == found.uncertainty.shape == (len(other),)
    assert cal.verify(other, identified, 1e-6).decision == "undecided"
    as_stated = cal.simulate(cell, plan=plan, seed=5).recording  # of a robot as stiff as the cell file says
    assert cal.verify(as_stated, identified, 1e-6).decision == "not_conforming"
    assert found.plot()._repr_svg_().startswith("<?xml")
    with pytest.raises(cal.InputError, match="places that were not used for the model"):
        cal.verify(cal.load_recording(BAG, cell), model, 1e-3)
    with pytest.raises(cal.InputError, match="--tolerance: found -1"):
        cal.verify(other, identified, -1.0)


@pytest.fixture(scope="module", params=["identify", "diagnose"])
def models(request: pytest.FixtureRequest, cell: cal.Cell, other: cal.Recording) -> tuple[Any, Any]:
    """What a command makes of a recording, and what is identified from another one with it."""
    model = getattr(cal, request.param)(other)
    return model, cal.identify(cal.load_recording(BAG, cell), model=model)


@pytest.fixture(scope="module")
def written(
    cell: cal.Cell, plan: cal.PlanResult, identified: cal.IdentificationResult, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The readings of `other` as a table."""
    folder = tmp_path_factory.mktemp("written")
    cal.simulate(cell, plan=plan, model=identified, seed=5).save(folder, report=False)
    return folder / "measurements.csv"


@pytest.fixture(scope="module")
def further(cell: cal.Cell, plan: cal.PlanResult, identified: cal.IdentificationResult) -> cal.Recording:
    return cal.simulate(cell, plan=plan, model=identified, seed=6).recording


@pytest.mark.parametrize("form", ["the same value", "table", "arrays"])
def test_verify_refuses_readings_of_the_model(
    form: str, cell: cal.Cell, other: cal.Recording, further: cal.Recording, written: Path, models: tuple[Any, Any]
) -> None:
    """A result knows what it was identified from, in whatever format that comes again."""
    model, from_it = models
    again = {
        "the same value": lambda: other,
        "table": lambda: cal.load_recording(written, cell),
        "arrays": lambda: cal.load_recording(other.tables["measurements"], cell),
    }[form]()
    with pytest.raises(cal.InputError, match=r"which the model was identified from, expected places that were not"):
        cal.verify(again, model, 1e-3)
    with pytest.raises(cal.InputError, match="which the model was identified from"):
        cal.verify(again, from_it, 1e-3)
    assert cal.verify(further, model, 5e-3).decision == "conforming"


def test_compare(cell: cal.Cell, recording: cal.Recording, folder: Path, other: cal.Recording, tmp_path: Path) -> None:
    same(cal.compare(recording, folder, cells=cell), tmp_path, "compare", BAG, folder)
    found = cal.compare(recording, other, other, dates=[dt.datetime(2026, k, 1, tzinfo=dt.UTC) for k in (1, 5, 9)])
    assert [one.verdict for one in found.differences[0] if one.quantity == "stiffness"].count("changed") == 0
    assert found.plot()._repr_svg_().startswith("<?xml")
    assert found.to_dict()["trends"]
    for wrong, words in (
        ({"dates": [dt.datetime(2026, 1, 1, tzinfo=dt.UTC)]}, "dates: found 1 dates"),
        ({"cells": [cell]}, "cells: found 1 cells"),
    ):
        with pytest.raises(cal.InputError, match=words):
            cal.compare(recording, other, **wrong)
    with pytest.raises(cal.InputError, match="cells: found none"):
        cal.compare(recording, folder)


@pytest.mark.parametrize("form", ["dh", "mjcf", "table"])
def test_export(cell: cal.Cell, folder: Path, identified: cal.IdentificationResult, tmp_path: Path, form: Any) -> None:
    model = folder / "model.yaml"
    found = cal.export(cell, model, form)
    same(found, tmp_path, "export", "--model", model, "--format", form)
    assert cal.export(cell, identified, form).exported.files == found.exported.files
    if form == "table":
        small = cal.export(cell, identified, form, joints=[1, 2], points=3, q=Q, ends=[-0.1, 0.1, 0.4, 0.6])
        lines = [len(one.exported.files["corrections.csv"].splitlines()) for one in (small, found)]
        assert lines[0] < lines[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([[0.0] * 5], PULL), r"task: found an array of shape \(1, 5\), expected shape \(1, 6\)"),
        (([[np.nan] * 6], PULL), "task: found nan"),
        ((Q, [1.0, 2.0]), r"wrench: found an array of shape \(2,\)"),
        (([Q, Q], [PULL] * 3), r"wrench: found an array of shape \(3, 6\)"),
        ((Q, [np.inf] * 6), "wrench: found inf"),
    ],
)
@pytest.mark.parametrize("function", [cal.deflect, cal.compensate])
def test_arguments_that_make_no_sense(
    cell: cal.Cell, identified: cal.IdentificationResult, function: Any, arguments: Any, words: str
) -> None:
    with pytest.raises(cal.InputError, match=words):
        function(cell, identified, *arguments)
    with pytest.raises(cal.InputError, match="payload"):
        function(cell, identified, Q, PULL, payload=[-1.0, 0.0, 0.0, 0.0])
    with pytest.raises(cal.InputError, match="axes: found 'world'"):
        function(cell, identified, Q, PULL, axes="world")


def test_nothing_that_pulls_deflects_nothing(cell: cal.Cell, identified: cal.IdentificationResult) -> None:
    with pytest.raises(cal.InputError, match="no load"):
        cal.deflect(cell, identified, Q)
