"""`calibration compare`: recordings and output folders of one robot beside each other."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import pytest
from program import CELL, KEYS, WRENCH, result_of, rewritten, run

from calibration_core.files.yaml_file import read_yaml, yaml_text


@pytest.fixture(scope="module")
def later(planned: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the same robot, its second joint softer by 15 %."""
    folder = tmp_path_factory.mktemp("later")
    content = read_yaml(CELL, 1 << 18, "cell").data
    content["robot"]["stiffness"][1] *= 0.85
    (folder / "soft.cell.yaml").write_text(yaml_text(content))
    arguments = ("--cell", folder / "soft.cell.yaml", "--plan", planned / "plan.yaml", "--seed", 3, "--no-report")
    assert run("simulate", *arguments, "--out", folder / "made") == 0
    return folder / "made" / "measurements.csv"


def differences(out: Path, pair: int = 0) -> dict[tuple[str, str], dict[str, object]]:
    rows = result_of(out)["comparisons"][pair]["differences"]
    return {(row["quantity"], row["location"]): row for row in rows}


def test_two_recordings(simulated: Path, later: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("compare", simulated / "measurements.csv", later, "--cell", CELL, "--out", tmp_path / "out") == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"result.json", "report.html", "report.pdf"}
    assert set(KEYS) <= set(result_of(tmp_path / "out"))
    rows = differences(tmp_path / "out")
    changed = [key for key, row in rows.items() if row["verdict"] == "changed"]
    assert changed == [("stiffness", "joint_2")]
    assert rows["stiffness", "joint_2"]["change"] == pytest.approx(-0.15, abs=0.04)
    assert {quantity for quantity, _ in rows} == {"stiffness", "backlash", "hysteresis"}
    result = result_of(tmp_path / "out")
    assert result["usable"] == "with_reservations"
    assert "changed: stiffness of joint_2" in result["reason"]
    assert result["next_step"]
    text = capsys.readouterr().out
    assert "joint_2" in text
    assert "changed" in text
    assert f"next: {result['next_step']}" in text.splitlines()


def test_a_folder_beside_a_recording_and_three_dates(
    simulated: Path, identified: Path, later: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("--cell", CELL, "--no-report", "--out", tmp_path / "out")
    dates = ("--dates", "2024-01-01", "2025-01-01", "2026-01-01")
    assert run("compare", identified, simulated / "measurements.csv", later, *arguments, *dates) == 0
    result = result_of(tmp_path / "out")
    assert [row["date"][:4] for row in result["measurements"]] == ["2024", "2025", "2026"]
    assert differences(tmp_path / "out", 1)["stiffness", "joint_2"]["verdict"] == "changed"
    trend = {row["location"]: row for row in result["trends"]}
    assert trend["joint_2"]["slope"] < 0
    assert result["remarks"]


def test_a_folder_with_a_rigid_joint(
    identified: Path, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rigid = tmp_path / "rigid"
    shutil.copytree(identified, rigid)
    model = read_yaml(rigid / "model.yaml", 1 << 24, "model").data
    model["compliance"][5] = 0.0
    model["stiffness"][5] = None
    (row,) = [row for row in model["parameters"] if row["name"] == "compliance.joint_6"]
    row["value"] = 0.0
    (rigid / "model.yaml").write_text(yaml_text(model))
    for k, pair in enumerate([(identified, rigid), (rigid, identified), (rigid, simulated / "measurements.csv")]):
        out = tmp_path / f"out{k}"
        assert run("compare", *pair, "--cell", CELL, "--out", out) == 0
        row = differences(out)["compliance", "joint_6"]
        assert row["unit"] == "rad/(N*m)"
        assert row["low"] < row["change"] < row["high"]
        assert 0.0 in {row["first"], row["second"]}
        assert "compliance of joint_6: " in capsys.readouterr().out
        assert "Compliance of rigid joints" in (out / "report.html").read_text(encoding="utf-8")


def test_recordings_at_rest_leave_nothing_to_compare(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rewritten(
        simulated / "measurements.csv", tmp_path / "rest.csv",
        lambda row: {k: v for k, v in row.items() if k not in WRENCH} if row["step"] == "0" else None,
    )  # fmt: skip
    found, out = tmp_path / "found", tmp_path / "out"
    assert run("identify", tmp_path / "rest.csv", "--cell", CELL, "--no-report", "--out", found) == 0
    assert run("compare", found, found, "--cell", CELL, "--out", out) == 0
    result = result_of(out)
    line = f"Nothing to compare: {found} and {found} have no stiffness, and no law of a joint, in common."
    assert line in capsys.readouterr().out.splitlines()
    assert line in result["remarks"]
    assert (result["recording"]["steps"], result["recording"]["loaded"]) == (12, False)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "No change found" not in page


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("{one}", "--cell", "{cell}"), "two or more"),
        (("{one}", "{two}", "--cell", "{cell}", "--cell", "{cell}", "--cell", "{cell}"), "one for each"),
        (("{one}", "{two}", "--cell", "{cell}", "--dates", "2024-01-01"), "--dates"),
        (("{one}", "{two}", "--cell", "{cell}", "--dates", "2024-01-01", "yesterday"), "ISO 8601"),
        (("{one}", "{two}", "--cell", "{cell}", "--cell", "{other}"), "robot"),
        (("{one}", "{old}", "--cell", "{cell}"), "schema: found 1, expected 2"),
    ],
)
def test_what_it_refuses(
    arguments: tuple[str, ...],
    text: str,
    simulated: Path,
    identified: Path,
    later: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    content = read_yaml(CELL, 1 << 18, "cell").data
    content["robot"]["name"] = "another robot"
    (tmp_path / "other.cell.yaml").write_text(yaml_text(content))
    old = tmp_path / "old"
    old.mkdir()
    model = read_yaml(identified / "model.yaml", 1 << 24, "model").data
    new = {"parameters", "covariance", "valid_range", "robot_sha256"}
    (old / "model.yaml").write_text(yaml_text({**{k: v for k, v in model.items() if k not in new}, "schema": 1}))
    (old / "result.json").write_bytes((identified / "result.json").read_bytes())
    files = {"one": simulated / "measurements.csv", "two": later, "cell": CELL, "other": tmp_path / "other.cell.yaml",
             "old": old}  # fmt: skip
    placed = [word.format(**files) for word in arguments]
    assert run("compare", *placed, "--out", tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert text in error
    assert len(error.splitlines()) <= 3  # progress may stand before the line
    assert not (tmp_path / "out").exists()


def test_every_file_of_every_measurement_has_its_digest(
    simulated: Path, identified: Path, later: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again = tmp_path / "identified_again"
    assert run("identify", later, "--cell", CELL, "--no-report", "--out", again) == 0
    other = tmp_path / "other.cell.yaml"
    other.write_bytes(CELL.read_bytes() + b"# the cell of another day\n")
    measurements = (simulated / "measurements.csv", later, simulated / "recording", identified, again)
    cells = [word for cell in (CELL, CELL, CELL, CELL, other) for word in ("--cell", cell)]
    assert run("compare", *measurements, *cells, "--out", tmp_path / "out") == 0
    listed = {(row["role"], row["file"]): row["sha256"] for row in result_of(tmp_path / "out")["input"]["sha256"]}
    files = [simulated / "measurements.csv", later, *sorted((simulated / "recording").iterdir())]
    files += [identified / "model.yaml", again / "model.yaml"]
    named = [("measurement", f"{path if path in measurements else path.parent}: {path.name}") for path in files]
    expected = dict(zip(named, files, strict=True)) | {("cell", str(CELL)): CELL, ("cell", str(other)): other}
    digests = {key: hashlib.sha256(path.read_bytes()).hexdigest() for key, path in expected.items()}
    assert {key: digest for key, digest in listed.items() if key[0] in {"measurement", "cell"}} == digests
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    for digest in digests.values():
        assert digest in page
