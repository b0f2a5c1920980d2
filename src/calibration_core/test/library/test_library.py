"""The library: everything of it is described, it does what the commands do, and it says no as they do."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calibration_core as cal
from calibration_core.cli import main, parse

ROOT = Path(__file__).resolve().parents[4]
BAG = ROOT / "bags" / "small_loaded"
CELL = ROOT / "config" / "cells" / "small.cell.yaml"
UNIT = re.compile(
    r"(?<![\w*])(m|mm|µm|rad|N|N\*m|N\*m/rad|rad/\(N\*m\)|%|SI|no unit|one sentence|file name|degrees)(?!\w)"
)
FUNCTIONS = [name for name in cal.__all__ if inspect.isfunction(getattr(cal, name))]
CLASSES = [name for name in cal.__all__ if inspect.isclass(getattr(cal, name))]
WITHOUT_QUANTITY = {"save", "files", "usable", "reason", "next_step", "verdict"}  # files and words


# --- what is public is described ------------------------------------------------------------------------------------


def test_nothing_else_is_public() -> None:
    assert sorted(cal.__all__) == cal.__all__
    assert set(dir(cal)) == {*cal.__all__, "__version__"}
    assert {*FUNCTIONS, *CLASSES} == set(cal.__all__)
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        _ = cal.identfy  # type: ignore[attr-defined]


def missing(function: Any) -> Iterator[str]:
    """What a function lacks: sections of its docstring, types, units."""
    text = inspect.getdoc(function) or ""
    signature = inspect.signature(function)
    parameters = [one for one in signature.parameters.values() if one.name != "self"]
    if not text:
        yield "docstring"
    if signature.return_annotation is inspect.Signature.empty:
        yield "type of what it returns"
    yield from (f"type of {one.name}" for one in parameters if one.annotation is inspect.Parameter.empty)
    if "arguments as for" not in text:
        yield from (
            f"argument {one.name}" for one in parameters if not re.search(rf"^\s+{one.name}: ", text, re.MULTILINE)
        )


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_described(name: str) -> None:
    function = getattr(cal, name)
    text = inspect.getdoc(function)
    assert list(missing(function)) == []
    assert UNIT.search(text), "units"
    assert "Raises:" in text
    assert "Source:" in text


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_is_described(name: str) -> None:
    kind = getattr(cal, name)
    assert inspect.getdoc(kind)
    silent = []
    for key, member in inspect.getmembers(kind, lambda one: isinstance(one, property) or inspect.isfunction(one)):
        owner = next(base for base in kind.__mro__ if key in vars(base))
        if key.startswith("_") or not owner.__module__.startswith("calibration_core"):
            continue
        function = member.fget if isinstance(member, property) else member
        silent += [f"{key}: {what}" for what in missing(function)]
        computes = owner.__module__.startswith("calibration_core.library") and key not in WITHOUT_QUANTITY
        if computes and "str" not in str(inspect.signature(function).return_annotation).split("[")[0]:
            silent += [] if UNIT.search(inspect.getdoc(function) or "") else [f"{key}: units"]
    assert silent == []


# --- light until it works -------------------------------------------------------------------------------------------


def loaded_by(code: str) -> set[str]:
    """Top-level modules in memory after a program."""
    program = f"{code}\nimport sys, json; print(json.dumps(sorted({{n.partition('.')[0] for n in sys.modules}})))"
    answer = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT, timeout=120
    )
    return set(json.loads(answer.stdout.splitlines()[-1]))


HEAVY = {"jinja2", "matplotlib", "plotly", "rich", "trimesh", "typst"}


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import calibration_core", {"numpy", "pydantic", "scipy", *HEAVY}),
        ("from calibration_core.cli import parse; parse(['identify', 'x', '--cell', 'y'])", {"numpy", "scipy", *HEAVY}),
        ("import calibration_core as cal; cal.load_cell", {"scipy", *HEAVY}),
        (
            f"from calibration_core.cli import main; main(['identify', {str(BAG)!r}, '--cell', {str(CELL)!r}, "
            "'--no-report', '--out', sys.argv[0]])".replace("sys.argv[0]", "'build/test-library'"),
            HEAVY,
        ),
    ],
    ids=["import", "arguments", "cell", "identify"],
)
def test_what_is_not_needed_is_not_loaded(code: str, absent: set[str]) -> None:
    assert loaded_by(code) & absent == set()


# --- what it answers ------------------------------------------------------------------------------------------------


def test_it_answers_as_the_command_does(identified: cal.IdentificationResult, tmp_path: Path) -> None:
    assert main(["identify", str(BAG), "--cell", str(CELL), "--no-report", "--out", str(tmp_path / "command")]) == 0
    path = identified.save(tmp_path / "library", report=False)
    files = {file.name for file in (tmp_path / "command").iterdir()}
    assert {file.name for file in path.parent.iterdir()} == files
    for name in files:
        assert (path.parent / name).read_bytes() == (tmp_path / "command" / name).read_bytes(), name
    assert identified.to_dict() == json.loads(path.read_text())


def test_values_agree_with_each_other(identified: cal.IdentificationResult) -> None:
    n = len(identified.joints)
    assert identified.stiffness.shape == (n,)
    assert identified.interval.shape == (n, 2)
    assert np.all(identified.interval[:, 0] < identified.stiffness)
    assert np.all(identified.stiffness < identified.interval[:, 1])
    np.testing.assert_allclose(identified.compliance * identified.stiffness, 1.0)
    assert identified.usable == "with_reservations"
    assert "12" in identified.reason
    assert identified.verdict == "consistent"
    for table in identified.tables.values():
        assert len({len(column) for column in table.values()}) == 1


def test_a_notebook_shows_it(identified: cal.IdentificationResult, recording: cal.Recording) -> None:
    page = identified._repr_html_()
    assert "usable with reservations" in page
    assert page.count("<tr>") == 1 + len(identified.joints)
    assert "<th>x</th>" in recording._repr_html_()
    for picture in (identified.plot(), recording.plot()):
        assert picture._repr_svg_().lstrip().startswith("<?xml")


def test_arrays_are_read_like_the_table(recording: cal.Recording, cell: cal.Cell) -> None:
    columns = recording.tables["measurements"]
    again = cal.load_recording(columns, cell, "memory")
    for name in ("q", "position", "wrench", "configuration", "step", "temperature"):
        np.testing.assert_array_equal(getattr(again, name), getattr(recording, name))
    np.testing.assert_allclose(cal.identify(again).stiffness, cal.identify(recording).stiffness, rtol=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q7": [0.0]}, "memory: columns, column 'q7': found an unknown column"),
        ({"x": [0.0]}, "memory: column x: found 1 rows, expected 36"),
        ({"y": [np.nan] * 36}, "memory: row 0, column y: found nan, expected a finite number"),
        ({"configuration": np.zeros((36, 2))}, "found an array of shape"),
    ],
)
def test_arrays_that_are_wrong(recording: cal.Recording, cell: cal.Cell, change: dict[str, Any], message: str) -> None:
    with pytest.raises(cal.InputError, match=re.escape(message)) as caught:
        cal.load_recording({**recording.tables["measurements"], **change}, cell, "memory")
    assert "\n" not in str(caught.value)


def test_a_frame_is_read(recording: cal.Recording, cell: cal.Cell) -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is not installed: `make docs` tests this")
    frame = recording.to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    np.testing.assert_array_equal(cal.load_recording(frame, cell).position, recording.position)


def test_an_unknown_table(identified: cal.IdentificationResult) -> None:
    with pytest.raises(cal.InputError, match="found 'residual', expected one of stiffness, parameters, residuals"):
        identified.to_dataframe("residual")


def test_input_that_is_not_what_it_claims(recording: cal.Recording, cell: cal.Cell) -> None:
    columns = dict(recording.tables["measurements"])
    columns |= {name: -np.asarray(columns[name]) for name in ("fx", "fy", "fz", "tx", "ty", "tz")}
    wrong = cal.load_recording(columns, cell)
    for found in (cal.identify(wrong), cal.diagnose(wrong)):
        assert found.usable == "no"
        assert "not usable" in found._repr_html_()
        assert found.to_dict()["stiffness"] == []
        assert found.to_dict()["anomalies"][0]["kind"] == "wrench_sign"
        with pytest.raises(cal.InputError, match="wrench_sign"):
            found.plot()
    assert cal.identify(wrong).stiffness.shape == (0,)


# --- the other functions --------------------------------------------------------------------------------------------


def test_plan_simulate_identify_predict(cell: cal.Cell, identified: cal.IdentificationResult) -> None:
    planned = cal.plan(cell, configurations=12, spares=0.5, seed=3, load_levels=(0.0, 1.0, 0.0))
    assert len(planned.tables["configurations"]["configuration"]) == 18
    assert planned.to_dict()["command"] == "plan"
    simulated = cal.simulate(cell, plan=planned, model=identified, seed=1)
    again = cal.identify(simulated.recording)
    inside = (again.interval[:, 0] < identified.stiffness) & (identified.stiffness < again.interval[:, 1])
    assert inside.sum() >= 5
    predicted = cal.predict(simulated.recording, again)
    assert predicted.predicted.shape == simulated.recording.position.shape
    fit = predicted.to_dict()["fit"]
    assert np.sqrt(np.mean(predicted.error**2) / 3) == pytest.approx(fit["rms_after"])
    assert fit["rms_after"] < 1.5 * fit["noise"]
    assert planned.plot().svg.startswith(b"<?xml")
    assert simulated.summary.startswith("12 configurations, 36 steps")


def test_a_plan_means_what_the_command_means() -> None:
    """The defaults of the function are those of the command."""
    options = vars(parse(["plan", "--cell", "x"]))
    given = inspect.signature(cal.plan).parameters
    shared = [name for name in given if name in options and name not in {"cell", "model"}]
    assert len(shared) >= 10
    assert {name: given[name].default for name in shared} == {name: options[name] for name in shared}


def test_a_diagnosis(recording: cal.Recording) -> None:
    found = cal.diagnose(recording)
    assert found.verdict in {"consistent", "partly_explained", "missing_physics", "unexplained"}
    assert len(found.tables["findings"]["effect"]) == len(found.findings)
    assert found.to_dict()["command"] == "diagnose"
    assert found.plot().title
