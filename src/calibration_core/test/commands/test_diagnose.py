"""`calibration diagnose` through the program: one recording, two, and what cannot be used."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from program import names, result_of, run


@pytest.fixture(scope="module")
def clean(planned: Path, cell_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same plan simulated without noise."""
    out = tmp_path_factory.mktemp("clean") / "out"
    plan = planned / "plan.yaml"
    assert run("simulate", "--cell", cell_path, "--plan", plan, "--out", out, "--no-report") == 0
    return out


@pytest.fixture(scope="module")
def diagnosed(simulated: Path, clean: Path, cell_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("diagnose") / "out"
    options = ("--cell", cell_path, "--simulation", clean / "measurements.csv", "--out", out)
    assert run("diagnose", simulated / "measurements.csv", *options) == 0
    return out


def test_the_set_is_complete(diagnosed: Path) -> None:
    assert names(diagnosed) >= {"result.json", "report.html", "report.pdf", "model.yaml", "table2.csv"}


def test_a_recording_like_its_simulation_differs_by_noise(diagnosed: Path, clean: Path) -> None:
    content = result_of(diagnosed)
    assert content["verdict"] == "consistent"
    compared = content["comparison"]
    assert compared["differences"] == []
    digests = {row["role"]: row["sha256"] for row in content["input"]["sha256"]}
    assert digests["simulation"] == hashlib.sha256((clean / "measurements.csv").read_bytes()).hexdigest()
    assert digests["simulation"] in (diagnosed / "report.html").read_text(encoding="utf-8")
    assert compared["reproduction"]["reproduced"] is True
    assert compared["step_by_step"]["rms"] < compared["step_by_step"]["noise"]
    assert len(compared["step_by_step"]["by_configuration"]) == 12


def test_a_simulation_with_the_wrong_sign_is_named(
    simulated: Path, clean: Path, cell_path: Path, tmp_path: Path
) -> None:
    head, *rows = (clean / "measurements.csv").read_text().splitlines()
    columns = head.split(",")
    wrench = [columns.index(name) for name in ("fx", "fy", "fz", "tx", "ty", "tz")]
    table = tmp_path / "other.csv"
    turned = []
    for row in rows:
        cells = row.split(",")
        for k in wrench:
            cells[k] = repr(-float(cells[k]))
        turned.append(",".join(cells))
    table.write_text("\n".join([head, *turned]) + "\n")
    recording, out = simulated / "measurements.csv", tmp_path / "out"
    assert run("diagnose", recording, "--cell", cell_path, "--simulation", table, "--out", out, "--no-report") == 0
    content = result_of(out)
    assert [(d["kind"], d["side"]) for d in content["comparison"]["differences"]] == [("wrench_sign", "simulation")]
    assert (content["verdict"], content["anomalies"]) == ("consistent", [])
    assert content["usable"] != "no"
    assert len(content["stiffness"]) == 6
    assert content["comparison"]["step_by_step"] is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "no such file"),
        ("", "a header line"),
        ("configuration,step\n1,0\n", "q1"),
        ("\0\0\0", ""),
    ],
)
def test_a_simulation_that_cannot_be_used_ends_with_one_line(
    simulated: Path, cell_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, words: str
) -> None:
    other, out = tmp_path / "other.csv", tmp_path / "out"
    if text is not None:
        other.write_text(text)
    recording = simulated / "measurements.csv"
    assert run("diagnose", recording, "--cell", cell_path, "--simulation", other, "--out", out) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "other.csv" in said
    assert words in said.lower()
    assert not out.exists()


def test_millimetres_in_a_simulation_are_refused_by_name(
    simulated: Path, clean: Path, cell_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head, *rows = (clean / "measurements.csv").read_text().splitlines()
    columns = head.split(",")
    place = [columns.index(name) for name in "xyz"]
    table = tmp_path / "mm.csv"
    scaled = [
        ",".join(repr(1e3 * float(cell)) if k in place else cell for k, cell in enumerate(row.split(",")))
        for row in rows
    ]
    table.write_text("\n".join([head, *scaled]) + "\n")
    recording, out = simulated / "measurements.csv", tmp_path / "out"
    assert run("diagnose", recording, "--cell", cell_path, "--simulation", table, "--out", out) == 2
    assert "a position in m" in capsys.readouterr().err
