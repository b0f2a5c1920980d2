"""`calibration plan` through the program: what it writes, what it promises, what it refuses."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from program import CELL, names, result_of, run

from calibration_core.cell import load_cell
from calibration_core.cli import parse
from calibration_core.commands.planning.plan import next_step
from calibration_core.commands.shared.common import typed
from calibration_core.planning.plans.plan_file import read_plan

DEMO = CELL.with_name("demo.cell.yaml")


def test_the_set_is_complete(planned: Path) -> None:
    assert names(planned) == {
        "result.json", "report.html", "report.pdf", "table1.csv", "table1.yaml", "plan.yaml",
    }  # fmt: skip
    assert (planned / "report.pdf").read_bytes().startswith(b"%PDF-")


def test_the_result_tells_what_was_planned(planned: Path, cell_path: Path) -> None:
    content = result_of(planned)
    assert content["command"] == "plan"
    assert content["recording"] == {
        "file": "plan.yaml", "configurations": 12, "steps": 108, "points": ["mp1", "mp2", "mp3"], "loaded": True,
    }  # fmt: skip
    assert (content["stiffness"], content["findings"], content["verdict"]) == ([], [], "consistent")
    assert content["spares"] == 6
    assert content["expected"]["efficiency"] > 0.9
    assert content["largest_force"] == pytest.approx(0.9 * 10 * 9.80665)
    assert {item["role"] for item in content["input"]["sha256"]} == {"cell"}


def test_the_end_effector_counts_towards_the_rated_load(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = yaml.safe_load(CELL.read_text(encoding="utf-8"))
    cell = tmp_path / "cell.yaml"
    for mass, code in ((2.0, 0), (9.5, 2), (10.0, 2)):
        cell.write_text(yaml.safe_dump({**content, "end_effector": {"mass": mass, "com": [0, 0, 0.1]}}))
        assert run("plan", "--cell", cell, "--configurations", 12, "--no-report", "--out", tmp_path / "out") == code
        if code:
            assert f"end_effector.mass: found {mass:g} kg" in capsys.readouterr().err
        else:
            assert result_of(tmp_path / "out")["largest_force"] == pytest.approx((9.0 - mass) * 9.80665)


def test_what_was_not_judged_is_told_everywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("plan", "--cell", DEMO, "--configurations", 12, "--out", tmp_path / "plan") == 0
    pairs = result_of(tmp_path / "plan")["expected"]["unjudged"]
    assert pairs == ["link 0 and link 2", "link 3 and link 6"]
    assert list(read_plan(tmp_path / "plan" / "plan.yaml", load_cell(DEMO)).expected.unjudged) == pairs
    for text in (capsys.readouterr().out, (tmp_path / "plan" / "report.html").read_text(encoding="utf-8")):
        assert f"not judged, for they touch by their shape alone: {', '.join(pairs)}" in text


def test_plan_and_table_1_agree(planned: Path, cell_path: Path) -> None:
    plan = read_plan(planned / "plan.yaml", load_cell(cell_path))
    with (planned / "table1.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == ["No", *(f"theta_{i}" for i in range(1, 7))]
    numbers, q = plan.table1()
    assert [int(row[0]) for row in rows[1:]] == numbers == list(range(1, 19))
    np.testing.assert_allclose(np.array(rows[1:], dtype=float)[:, 1:], np.degrees(q), atol=6e-7)
    same = yaml.safe_load((planned / "table1.yaml").read_text())
    assert [list(map(float, row.values())) for row in same] == [list(map(float, row)) for row in rows[1:]]
    assert list(same[0]) == rows[0]


def test_the_report_shows_certificate_spares_and_cycle(planned: Path) -> None:
    page = (planned / "report.html").read_text(encoding="utf-8")
    for text in (
        "12 configurations and 6 spares planned",
        "of what any choice among the candidates could reach",
        "No 13 to 18 are spares",
        "Reference configuration",
        "Start-up cycle",
        "8 of 10 met, 2 not visible in the plan" if "calibrated" in page else "7 of 9 met",
        "not needed",
        "What other load steps would show",
        "minutes without spares",
        "K_CSM moves no point by more than",
        "plan.yaml" if "plan.yaml" in page else "Full pull of every configuration",
    ):
        assert text in page


def test_the_same_seed_gives_the_same_plan_and_options_reach_the_planner(
    planned: Path, cell_path: Path, tmp_path: Path
) -> None:
    options = ("--cell", cell_path, "--configurations", 12, "--seed", 4, "--no-report")
    assert run("plan", *options, "--out", tmp_path / "same") == 0
    assert (tmp_path / "same" / "plan.yaml").read_bytes() == (planned / "plan.yaml").read_bytes()
    assert names(tmp_path / "same") == {"result.json", "table1.csv", "table1.yaml", "plan.yaml"}
    further = (
        "--spares",
        0,
        "--load-levels",
        0,
        1,
        0,
        "--load-share",
        0.5,
        "--largest-force",
        40,
        "--out",
        tmp_path / "b",
    )
    assert run("plan", *options, *further) == 0
    assert result_of(tmp_path / "b")["notes"] == []  # back to zero: drift shows
    plan = yaml.safe_load((tmp_path / "b" / "plan.yaml").read_text())
    assert len(plan["configurations"]) == 12
    force = np.linalg.norm(np.array(plan["configurations"][0]["steps"])[:, :3], axis=1)
    np.testing.assert_allclose(force, [0.0, 40.0, 0.0])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--configurations", 11), "plan: --configurations: found 11, expected 12 to 200"),
        (("--spares", "nan"), "plan: --spares: found nan, expected a share"),
        (("--load-levels", 0.5, 1), "the first 0"),
        (("--load-levels", 0, "nan"), "shares from -1"),
        (("--load-share", 1.2), "at most 1"),
        (("--largest-force", -1), "a positive number"),
        (("--largest-torque", "inf"), "a positive number"),
        (("--box", 1, 0, 0, 1, 0, 1), "lower < upper"),
        (("--box", 0, 1, 0, 1, 0, 1, "--cube"), "one operating space"),
        (("--cube", "nan"), "the side of a cube"),
        (("--cube", 4.5), "a cube of 4500 mm"),
        (("--task", "nowhere.csv"), "a readable table"),
        (("--protocol", "hold"), "one of loading, unloading, small-steps, reversed, references"),
        (("--protocol", "loading", "--load-levels", 0, 1), "one of them"),
        (("--box", 50, 51, 50, 51, 50, 51), "postures"),
        (("--model", "nowhere.yaml"), "a readable model file"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_one_line(
    arguments: tuple[object, ...], words: str, cell_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("plan", "--cell", cell_path, "--out", tmp_path / "out", *arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert words in printed.err
    assert not (tmp_path / "out").exists()


def test_an_identified_model_plans_too(planned: Path, identified: Path, cell_path: Path, tmp_path: Path) -> None:
    model = identified / "model.yaml"
    options = ("--configurations", 12, "--seed", 4, "--no-report", "--out", tmp_path / "out")
    assert run("plan", "--cell", cell_path, "--model", model, "--load-levels", 0, 1, *options) == 0
    content = result_of(tmp_path / "out")
    assert [note["kind"] for note in content["notes"]] == ["no_return_to_zero"]  # drift would be hidden
    assert [item["role"] for item in content["input"]["sha256"]] == ["cell", "model"]
    assert content["expected"]["stiffness_std"] != result_of(planned)["expected"]["stiffness_std"]


def test_protocols_are_judged_in_the_result(planned: Path) -> None:
    judged = {one["name"]: one for one in result_of(planned)["protocols"]}
    assert next(iter(judged)) == "loading"
    assert judged["unloading"]["minutes"] > judged["loading"]["minutes"]
    assert set(judged["everything"]["told"]) >= set(judged["loading"]["told"])
    assert len(judged["hold"]["stiffness_std"]) == 6


def test_a_cube_and_a_named_protocol(cell_path: Path, tmp_path: Path) -> None:
    options = ("--configurations", 12, "--spares", 0, "--no-report", "--cube", 0.25, "--protocol", "reversed")
    assert run("plan", "--cell", cell_path, "--out", tmp_path / "out", *options) == 0
    plan = yaml.safe_load((tmp_path / "out" / "plan.yaml").read_text())
    force = np.array(plan["configurations"][0]["steps"])[:, :3]
    assert force[2] @ force[6] == pytest.approx(-(force[2] @ force[2]))


def test_poses_that_decide_whether_a_calibration_holds(
    identified: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """5 to 8 of them, written as any plan; what is missing or senseless is said in one line."""
    model, out = identified / "model.yaml", tmp_path / "out"
    arguments = ("--cell", CELL, "--for", "verify", "--out", out, "--no-report")
    for given, place in (
        ((), "--model"),
        (("--model", model), "--tolerance"),
        (("--model", model, "--tolerance", "-1"), "--tolerance"),
        (("--model", model, "--tolerance", "1e-4", "--risk", "0.9"), "--risk"),
        (("--model", model, "--tolerance", "1e-4", "--phases"), "--phases"),
        (("--model", model, "--tolerance", "1e-6"), "at least"),
    ):
        assert run("plan", *arguments, *given) == 2
        assert place in capsys.readouterr().err
        assert not out.exists()
    assert run("plan", *arguments, "--model", model, "--tolerance", "1.5e-4", "--risk", "0.05") == 0
    assert 5 <= len(read_plan(out / "plan.yaml", load_cell(CELL)).primary) <= 8
    found = result_of(out)["verify"]
    assert found["decides"] is True
    assert found["least_tolerance"] < 1.5e-4
    following = ("verify", "RECORDING", "--cell", CELL, "--model", model, "--tolerance", "0.00015", "--fit-tracker")
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == f"next: measure it, then {typed(*following)}"
    assert [line for line in lines if re.search(r"calibration [a-z]+ RECORDING", line)] == lines[
        -1:
    ]  # one next step, not two


def test_the_smallest_tolerance_that_a_refusal_states_is_accepted(
    identified: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = identified / "model.yaml"
    arguments = ("--cell", CELL, "--for", "verify", "--model", model, "--risk", "0.1", "--no-report")
    least, tried = 2e-5, []
    while run("plan", *arguments, "--tolerance", f"{least:g}", "--out", tmp_path / "out") == 2:
        stated = re.search(r"found (\S+) m, expected at least (\S+) m", capsys.readouterr().err)
        assert stated
        assert float(stated[1]) < float(stated[2])
        least = float(stated[2])
        tried.append(least)
        assert len(tried) < 4
    assert tried
    assert result_of(tmp_path / "out")["verify"]["least_tolerance"] <= least
    shown = re.search(r"smallest tolerance with these instruments (\S+) mm", capsys.readouterr().out)
    assert shown
    assert 1e-3 * float(shown[1]) >= result_of(tmp_path / "out")["verify"]["least_tolerance"]


@pytest.mark.parametrize(("options", "following"), [
    ((), ("identify", "RECORDING", "--cell", CELL)),
    (("--population", "p.yaml"), ("diagnose", "RECORDING", "--cell", CELL, "--population", "p.yaml")),
    (("--population", "p.yaml", "--type", "a b"),
     ("diagnose", "RECORDING", "--cell", CELL, "--population", "p.yaml", "--type", "a b")),
    (("--for", "geometry"), ("identify", "RECORDING", "--cell", CELL)),
    (("--for", "verify", "--model", "m.yaml", "--tolerance", "1.1e-4"),
     ("verify", "RECORDING", "--cell", CELL, "--model", "m.yaml", "--tolerance", "0.00011", "--fit-tracker")),
])  # fmt: skip
def test_the_next_step_is_what_the_plan_is_for(options: tuple[str, ...], following: tuple[object, ...]) -> None:
    assert next_step(parse(["plan", "--cell", str(CELL), *options])) == typed(*map(str, following))
