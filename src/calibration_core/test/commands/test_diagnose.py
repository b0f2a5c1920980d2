"""`calibration diagnose` through the program: one recording, two, and what cannot be used."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest
from program import result_of, rewritten, run


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


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_a_report_names_options_that_its_command_takes(
    simulated: Path, cell_path: Path, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is said of a reading that was not used can be done."""

    def moved(row: dict[str, str]) -> dict[str, str]:
        wrong = (row["configuration"], row["step"], row["point"]) == ("2", "4", "mp2")
        return row | {"x": repr(float(row["x"]) + 3e-3 * wrong)}

    rewritten(simulated / "measurements.csv", tmp_path / "other.csv", moved)
    assert run(command, tmp_path / "other.csv", "--cell", cell_path, "--out", tmp_path / "out") == 0
    _, _, section = (tmp_path / "out" / "report.html").read_text(encoding="utf-8").partition("Readings not used</")
    named = set(re.findall(r"--[a-z][a-z-]+", section.partition("</section>")[0]))
    capsys.readouterr()
    with pytest.raises(SystemExit):
        run(command, "--help")
    taken = set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out))
    assert "--no-robust" in named
    assert named <= taken, named - taken


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


def test_postures_beside_loaded_configurations_stand_in_result_and_report(
    simulated: Path, clean: Path, cell_path: Path, tmp_path: Path
) -> None:
    def kept(row: dict[str, str]) -> dict[str, str] | None:
        return row if int(row["configuration"]) <= 8 or row["step"] == "0" else None

    ours, theirs = (
        rewritten(folder / "measurements.csv", tmp_path / name, kept)
        for folder, name in ((simulated, "ours.csv"), (clean, "theirs.csv"))
    )
    assert run("diagnose", ours, "--cell", cell_path, "--simulation", theirs, "--out", tmp_path / "out") == 0
    compared = result_of(tmp_path / "out")["comparison"]
    steps = compared["step_by_step"]
    sizes = {one["name"]: one["rms"] for one in steps["by_configuration"]}
    assert sorted(map(int, sizes)) == list(range(1, 13))
    assert all(0.0 < size < 2 * steps["noise"] for size in sizes.values())
    assert any("Over 4 common configurations with one step the positions" in one for one in compared["sentences"])
    shown = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Largest differences of positions, configurations with one step" in shown


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
