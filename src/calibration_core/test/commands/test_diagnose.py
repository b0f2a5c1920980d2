"""`calibration diagnose` through the program: one recording, two, and what cannot be used."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest
from program import WRENCH, names, result_of, rewritten, run, scaled


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


def test_a_simulation_with_the_wrong_sign_is_named(
    simulated: Path, clean: Path, cell_path: Path, tmp_path: Path
) -> None:
    table = rewritten(clean / "measurements.csv", tmp_path / "other.csv", lambda row: scaled(row, WRENCH, -1.0))
    recording, out = simulated / "measurements.csv", tmp_path / "out"
    assert run("diagnose", recording, "--cell", cell_path, "--simulation", table, "--out", out, "--no-report") == 0
    content = result_of(out)
    assert [(d["kind"], d["side"]) for d in content["comparison"]["differences"]] == [("wrench_sign", "simulation")]
    assert (content["verdict"], content["anomalies"]) == ("consistent", [])
    assert content["usable"] != "no"
    assert len(content["stiffness"]) == 6
    (turned_back,) = content["comparison"]["differences"]
    assert "read as if this were put right" in turned_back["text"]
    assert not turned_back["spoils"]
    steps = content["comparison"]["step_by_step"]
    assert steps["rms"] < steps["noise"]


def test_a_tracker_that_jumps_in_the_simulation_leaves_the_recording_usable(
    simulated: Path, clean: Path, diagnosed: Path, cell_path: Path, tmp_path: Path
) -> None:
    def moved(row: dict[str, str]) -> dict[str, str]:
        return row | {"z": repr(float(row["z"]) + (0.03 if int(row["configuration"]) > 7 else 0.0))}

    table, out = rewritten(clean / "measurements.csv", tmp_path / "jump.csv", moved), tmp_path / "out"
    recording = simulated / "measurements.csv"
    assert run("diagnose", recording, "--cell", cell_path, "--simulation", table, "--out", out, "--no-report") == 0
    content, alone = result_of(out), result_of(diagnosed)
    same = ("usable", "reason", "verdict", "stiffness", "findings", "anomalies", "fit")
    assert {key: content[key] for key in same} == {key: alone[key] for key in same}
    differences = content["comparison"]["differences"]
    assert ("tracker_moved", "simulation") in [(one["kind"], one["side"]) for one in differences]
    assert {one["side"] for one in differences if one["spoils"]} == set()
    assert set(differences[0]) == {"kind", "location", "side", "magnitude", "unit", "text", "spoils"}


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


def test_millimetres_in_a_simulation_are_named_and_put_right(
    simulated: Path, clean: Path, cell_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = rewritten(clean / "measurements.csv", tmp_path / "mm.csv", lambda row: scaled(row, ("x", "y", "z"), 1e3))
    recording, out = simulated / "measurements.csv", tmp_path / "out"
    assert run("diagnose", recording, "--cell", cell_path, "--simulation", table, "--out", out) == 0
    assert "the simulation in mm" in capsys.readouterr().out
    (difference,) = result_of(out)["comparison"]["differences"]
    assert (difference["kind"], difference["side"]) == ("position_unit", "simulation")
