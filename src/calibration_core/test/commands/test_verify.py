"""`calibration verify`: decision, certificate, and what it refuses."""

from __future__ import annotations

import itertools
import re
import shutil
from pathlib import Path

import pytest
from program import CELL, KEYS, result_of, rewritten, run

from calibration_core.acceptance.verification import SOURCES
from calibration_core.cell import load_cell
from calibration_core.files.yaml_file import read_yaml, yaml_text


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording at other places than those of the model."""
    folder = tmp_path_factory.mktemp("other")
    arguments = ("--cell", CELL, "--no-report")
    assert run("plan", *arguments, "--out", folder / "plan", "--configurations", 12, "--seed", 9) == 0
    assert (
        run("simulate", *arguments, "--plan", folder / "plan" / "plan.yaml", "--seed", 8, "--out", folder / "made") == 0
    )
    return folder / "made" / "measurements.csv"


def named_cell(folder: Path) -> Path:
    """The cell with everything that a certificate names."""
    content = read_yaml(CELL, 1 << 18, "cell").data
    content["robot"] |= {"maker": "A. Maker", "serial": "SN 4711"}
    content["instruments"]["tracker"] |= {"serial": "LT 12", "calibrated": "2026-03-01"}
    content["instruments"]["force_torque"] |= {"serial": "FT 34", "calibrated": "2026-02-01"}
    content["certificate"] = {
        "laboratory": "Laboratory of Robots, 1 Main Street", "customer": "A. Customer Ltd", "place": "Hall 3",
        "operator": "A. Operator",
    }  # fmt: skip
    path = folder / "named.cell.yaml"
    path.write_text(yaml_text(content))
    return path


def test_a_decision_with_a_certificate(identified: Path, other: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    model = identified / "model.yaml"
    assert run("verify", other, "--cell", CELL, "--model", model, "--tolerance", 1e-4, "--out", out) == 0
    assert {path.name for path in out.iterdir()} == {"result.json", "report.html", "report.pdf", "certificate.pdf"}
    for name in ("report.pdf", "certificate.pdf"):
        assert (out / name).read_bytes().startswith(b"%PDF")
    result = result_of(out)
    assert set(KEYS) <= set(result)
    assert result["decision"] == "conforming"
    assert result["decision_rule"]["standard"] == "ISO 14253-1"
    assert len(result["places"]) == 12
    assert result["uncertainty"]["expanded"] == pytest.approx(2 * result["uncertainty"]["standard"])
    assert set(result["uncertainty"]["contributions"]) == {"tracker", "wrench", "geometry", "model", "repeatability"}
    assert result["error"]["before"]["mean"] > 0
    assert (result["verdict"], result["usable"], result["next_step"]) == ("consistent", "yes", "")
    page = (out / "report.html").read_text(encoding="utf-8")
    numbers = re.findall(r"Table (\d+)</strong>", page.replace("\u00a0", " "))
    assert len(numbers) == len(set(numbers)) > 5
    shown = re.findall(r'<td data-head="Contribution to u [^"]*"[^>]*>([\d.]+)</td>', page)
    stated = result["uncertainty"]
    expected = [*(stated["contributions"][source] for source in SOURCES), stated["standard"], stated["expanded"]]
    assert [float(text) for text in shown] == [pytest.approx(1e6 * value, rel=0.06) for value in expected]
    tight = tmp_path / "tight"
    arguments = ("--cell", CELL, "--model", model, "--out", tight, "--no-report")
    assert run("verify", other, *arguments, "--tolerance", 5e-6) == 0  # exit code 0, whatever it decides
    assert result_of(tight)["decision"] in {"undecided", "not_conforming"}
    assert {path.name for path in tight.iterdir()} == {"result.json"}


def test_the_light_is_that_of_the_decision(
    identified: Path, other: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A model that does not conform is never `consistent` and usable."""
    arguments = ("--cell", CELL, "--model", identified / "model.yaml", "--out", tmp_path / "out", "--no-report")
    assert run("verify", other, *arguments, "--tolerance", 3e-5) == 0
    open_ = result_of(tmp_path / "out")
    assert (open_["decision"], open_["verdict"], open_["usable"]) == ("undecided", "consistent", "with_reservations")
    assert "undecided because of measurement uncertainty: configuration" in open_["reason"]
    assert f"next: {open_['next_step']}" in capsys.readouterr().out.splitlines()

    def third(row: dict[str, str]) -> dict[str, str]:
        return row | {"x": repr(float(row["x"]) + (1e-3 if row["configuration"] == "3" else 0.0))}

    moved = rewritten(other, tmp_path / "moved.csv", third)
    assert run("verify", moved, *arguments, "--tolerance", 1e-4) == 0
    wrong = result_of(tmp_path / "out")
    assert (wrong["decision"], wrong["verdict"], wrong["usable"]) == (
        "not_conforming", "unexplained", "with_reservations",
    )  # fmt: skip
    assert wrong["unexplained"]["significant"]
    assert wrong["unexplained"]["where"] == {"configurations": [3]}
    assert wrong["reason"].startswith("not conforming to the tolerance of 0.1 mm: configuration 3")
    assert wrong["next_step"].startswith("run diagnose")
    assert f"next: {wrong['next_step']}" in capsys.readouterr().out.splitlines()


def test_the_certificate_says_what_iso_iec_17025_asks_for(identified: Path, other: Path, tmp_path: Path) -> None:
    """Clauses 7.8.2 and 7.8.4: who, for whom, what, with what, when, how well, by which rule."""
    from calibration_core.acceptance.verification import verify
    from calibration_core.model.identified.model_file import read_calibrated
    from calibration_core.observations.observe import observe
    from calibration_core.report.documents.verification import certificate_document

    cell = load_cell(named_cell(tmp_path))
    readings = observe(other, cell)
    model = read_calibrated(identified / "model.yaml", load_cell(CELL))
    found = verify(readings, cell, model, 1e-4)
    document = certificate_document(found, cell, b"{}", {"model": {"model.yaml": "a" * 64}})
    text = repr(document).replace("\\xa0", " ")
    assert document.title == "Calibration certificate"
    assert len(document.number) > 8
    assert len(document.signatures) == 2
    for words in (
        "Laboratory of Robots, 1 Main Street", "A. Customer Ltd", "Hall 3", "A. Operator", "A. Maker", "SN 4711",
        "LT 12", "2026-03-01", "FT 34", "2026-02-01", "Date of issue", "Date of the test", "relate only to the robot",
        "except in full", "traceable to the SI", "ISO 14253-1", "95 %", "Uncertainty budget", "(k = 2)", "Temperature",
        "Laser tracker", "Force/torque sensor", "Geometry, frames", "Repeatability", "before: the cell file",
        "interval of calibration",
    ):  # fmt: skip
        assert words in text, words


@pytest.mark.parametrize("missing", ["certificate", "serial", "tracker", "nothing"])
def test_only_what_is_known_is_certified(missing: str, identified: Path, other: Path, tmp_path: Path) -> None:
    from calibration_core.acceptance.verification import verify
    from calibration_core.model.identified.model_file import read_calibrated
    from calibration_core.observations.observe import observe
    from calibration_core.report.documents.verification import certificate_document

    cell = load_cell(named_cell(tmp_path))
    update: dict[str, object] = {}
    if missing == "certificate":
        update = {"certificate": type(cell.certificate)()}
    elif missing == "serial":
        update = {"robot": cell.robot.model_copy(update={"serial": ""})}
    elif missing == "tracker":
        tracker = cell.instruments.tracker.model_copy(update={"calibrated": ""})
        update = {"instruments": cell.instruments.model_copy(update={"tracker": tracker})}
    cell = cell.model_copy(update=update)
    found = verify(observe(other, cell), cell, read_calibrated(identified / "model.yaml", load_cell(CELL)), 1e-4)
    document = certificate_document(found, cell, b"{}", {"model": {"model.yaml": "a" * 64}})
    text = repr(document).replace("\\xa0", " ")
    certified = missing in {"tracker", "nothing"}
    assert document.title == ("Calibration certificate" if certified else "Verification record")
    assert ("written approval" in text) == certified
    assert ("are traceable to the SI" in text) == (missing != "tracker")
    assert ("Traceability to the SI is not shown" in text) == (missing == "tracker")


def test_the_date_of_a_table_is_stated_or_read(
    identified: Path, other: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table without a date has that of `--date`; Unix time is a date, and is not overruled (CWA 17384, 8 b)."""
    common = ("--cell", CELL, "--model", identified / "model.yaml", "--no-report", "--out", tmp_path / "out")
    tables = {}
    for name, start in (("seconds", 0.0), ("unix", 1_764_547_200.0)):  # 2025-12-01
        count = itertools.count()
        tables[name] = rewritten(
            other, tmp_path / f"{name}.csv", lambda row, begin=start, k=count: row | {"time": repr(begin + next(k))}
        )
    for command, options in (("verify", ("--tolerance", 1e-4)), ("predict", ())):
        for name, dated, start in (("seconds", ("--date", "2026-05-31"), "2026-05-31"), ("seconds", (), ""),
                                   ("unix", (), "2025-12-01T00:00:00+00:00")):  # fmt: skip
            assert run(command, tables[name], *common, *options, *dated) == 0
            assert result_of(tmp_path / "out")["input"]["recording"]["start"] == start
        capsys.readouterr()
        assert run(command, tables["unix"], *common, *options, "--date", "2026-05-31") == 2
        assert "--date: found 2026-05-31 for a recording that states its own date" in capsys.readouterr().err


def test_the_recording_of_the_model_itself_is_refused(
    identified: Path, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("--cell", CELL, "--model", identified / "model.yaml", "--tolerance", 1e-4, "--out", tmp_path / "out")
    assert run("verify", simulated / "recording", *arguments) == 2
    text = capsys.readouterr().err
    assert "was identified from" in text
    assert not (tmp_path / "out").exists()
    alone = tmp_path / "alone"
    alone.mkdir()
    shutil.copy(identified / "model.yaml", alone / "model.yaml")
    files = ("--cell", CELL, "--model", alone / "model.yaml", "--tolerance", 1e-4, "--out", tmp_path / "out")
    capsys.readouterr()
    assert run("verify", simulated / "recording", *files, "--no-report") == 0
    assert "was identified from this recording is not checked" in capsys.readouterr().out


def test_the_readings_of_the_model_are_refused_in_another_format(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, fitted = tmp_path / "table.csv", tmp_path / "fitted"
    shutil.copy(simulated / "measurements.csv", table)
    assert run("identify", table, "--cell", CELL, "--out", fitted, "--no-report") == 0
    arguments = ("--cell", CELL, "--model", fitted / "model.yaml", "--tolerance", 1e-4, "--no-report", "--out")
    capsys.readouterr()
    assert run("verify", simulated / "recording", *arguments, tmp_path / "out") == 2
    text = capsys.readouterr().err
    assert f"that are those of {table}, which the model was identified from" in text
    assert not (tmp_path / "out").exists()
    changed = tmp_path / "changed.csv"
    changed.write_bytes(table.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", b"\n\n"))
    assert run("verify", changed, *arguments, tmp_path / "out") == 2
    assert "which the model was identified from" in capsys.readouterr().err
    table.unlink()  # what is no longer there cannot be compared, and the result says so
    assert run("verify", simulated / "recording", *arguments, tmp_path / "out") == 0
    assert f"the readings of {table}, which the model was identified from, is not checked" in capsys.readouterr().out
    assert any("is not checked" in note["text"] for note in result_of(tmp_path / "out")["notes"])
