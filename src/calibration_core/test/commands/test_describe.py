"""What `describe` says of results: the decision, the numbers with their units and intervals, and the next step."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from program import CELL, run

from calibration_core.cell.library import library
from calibration_core.cli import argument_parser
from calibration_core.commands import WITHOUT_RESULT
from calibration_core.commands.files.describe import SENTENCES, describe

PULL = ("--wrench", "50 0 -60 0 0 1")
POSTURE = "0.1 0.5 0.2 0.3 0.7 0.1"


@pytest.fixture(scope="module")
def results(identified: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder for each kind of result: of every command, every purpose of a plan, and every format."""
    folder, common = tmp_path_factory.mktemp("described"), ("--cell", CELL, "-q", "--no-report")
    model, other = ("--model", identified / "model.yaml"), folder / "simulate" / "measurements.csv"
    task, plant = folder / "task.csv", folder / "plant.csv"
    task.write_text(f"q1,q2,q3,q4,q5,q6\n{POSTURE.replace(' ', ',')}\n7,7,7,7,7,7\n")
    plant.write_text(
        "recording,cell,robot,type,date\n"
        + "".join(f"simulate/{name},{CELL},{name},small,2026-01-05\n" for name in ("recording", "gone.csv"))
    )
    bare = ("-q", "--no-report")
    for out, arguments in {
        "simulate": ("simulate", "--seed", 8, *common),
        "identify": ("identify", other, *common),
        "diagnose": ("diagnose", other, *common),
        "verify": ("verify", other, *model, "--tolerance", "1e-4", *common),
        "compare": ("compare", identified, other, *common),
        "predict": ("predict", other, *model, *common),
        "deflect": ("deflect", *model, *PULL, "--q", POSTURE, *common),
        "compensate": ("compensate", task, *model, *PULL, *common),
        "init": ("init", next(iter(library())), "-q"),
        "check": ("check", CELL, *bare),
        "check a recording": ("check", CELL, other, *bare),
        "import": ("import", other, "-q"),
        "fleet": ("fleet", plant, "--jobs", 1, *bare),
        "plan": ("plan", "--configurations", 12, "--phases", *common),
        "plan for geometry": ("plan", "--for", "geometry", "--configurations", 14, *common),
        "plan for verify": ("plan", "--for", "verify", *model, "--tolerance", "1.5e-4", *common),
        **{f"export {form}": ("export", "--format", form, *model, "--cell", CELL, "-q")
           for form in ("urdf", "dh", "mjcf", "table")},
    }.items():  # fmt: skip
        assert run(*arguments, "--out", folder / out) == 0, out
    return folder


def choices(command: str, option: str) -> set[str]:
    """The values that an option of a command takes."""
    return {str(one) for action in subparsers()[command]._actions if option in action.option_strings
            for one in action.choices or ()}  # fmt: skip


def subparsers() -> Mapping[str, argparse.ArgumentParser]:
    (found,) = (one for one in argument_parser()._actions if isinstance(one, argparse._SubParsersAction))
    return found.choices


def test_every_kind_of_result_has_words(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A new command, purpose of a plan or format of an export fails here until `describe` has words for its result."""
    kinds, written = {path.name for path in results.iterdir() if path.is_dir()}, set(subparsers()) - {*WITHOUT_RESULT}
    assert set(SENTENCES) == written
    assert {kind.partition(" ")[0] for kind in kinds} == written
    assert {f"export {form}" for form in choices("export", "--format")} - {"export ur"} <= kinds  # ur needs a template
    assert {f"plan for {purpose}" for purpose in choices("plan", "--for")} - {"plan for stiffness"} <= kinds
    for kind in sorted(kinds):
        capsys.readouterr()
        assert run("describe", results / kind) == 0
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) >= 3, (kind, lines)
        assert any(line.startswith("Next step: ") for line in lines), (kind, lines)
        if kind != "export mjcf":  # nothing is compared there
            assert any(re.search(r"\d", line) for line in lines[1:]), (kind, lines)
        assert not re.search(r"\bNone\b|\bnan\b|[-−]0(\.0+)?\b(?!\.\d)", "\n".join(lines)), (kind, lines)


@pytest.mark.parametrize(("command", "said"), [
    ("verify", (r"The robot conforms to the tolerance of 0\.100 mm \(ISO 14253-1, conformance probability 95 %\)\.",
                r"error of a reading is 0\.01\d mm on average and 0\.0\d\d mm at most; with the cell file's model",
                r"The expanded uncertainty of the least certain reading is 0\.0\d\d mm \(k = 2\)\.",
                r"^Next step: use the model within this tolerance")),
    ("compare", (r"stiffness of joint_1 has .*: the difference is \S+ % \(95 % interval \S+ % to \S+ %\)",
                 "^Next step: ")),
    ("predict", (r"error of a reading is 0\.\d\d\d mm on average and 0\.\d\d\d mm at most\.",
                 r"is \S+ times the 0\.00\d mm that noise and the model's intervals let expect\.",
                 r"The error of the deflection alone is 0\.\d\d\d mm on average")),
    ("deflect", (r"the load moves the tool by 0\.\d\d\d mm at most, in 1 row",
                 r"In row 1 it moves by \(\S+ ± \S+, \S+ ± \S+, \S+ ± \S+\) mm and turns by \(.*\) mrad",
                 r"\d N/µm in the softest direction and \S+ N/µm in the stiffest",
                 "^Next step: calibration compensate")),
    ("compensate", (r"Corrected targets were found for 1 of 2 rows\.", r"off by 0\.\d\d\d mm on average",
                    r"error stays in 95 % of cases below 0\.\d\d\d mm", r"1 row refused \(row 2: .*\)",
                    "^Next step: change the rows that were refused")),
    ("plan", (r"Expected standard deviation of the stiffness: joint_1 \S+ %, .*joint_6 \S+ %\.",
              r"By criterion D the choice reaches at least \S+ % of what any choice could and has the condition number",
              r"It takes about \d+ minutes", "Postures of the phases before: ",
              "^Next step: measure the plan, then run calibration identify")),
    ("plan for geometry", (r"\d+ parameters of frames and geometry are found", r"stay nominal: d_1, ",
                           "^Next step: measure the plan, then run calibration identify")),
    ("plan for verify", (r"within the tolerance of 0\.150 mm, with a risk of either wrong answer of 5 %\.",
                         r"Any single change that reaches the tolerance in 5 % of the operating space is seen\.",
                         r"The smallest tolerance with these poses and instruments is 0\.0\d\d\d mm\.",
                         "^Next step: measure the plan, then run calibration verify .* --tolerance 0.00015 and --fit")),
    ("export table", (r"in the format table: corrections\.csv\.", r"Deviation of the flange between nodes, beside",
                      r"largest \S+ µm, root mean square \S+ µm, at 1,000 postures\.", "^Next step: ")),
    ("export urdf", (r"in the format urdf: kinematics\.yaml, robot\.urdf\.", "Deviation of kinematics of the URDF")),
    ("simulate", (r"the cell file's model predicts, with noise of seed 8", r"move mp\d by \d\.\d\d\d mm at most")),
    ("import", (r"486 rows, .*taken as configuration, step, ", "^Next step: calibration identify")),
    ("init", (r"\d joints, rated load \S+ kg", "^Next step: calibration check")),
    ("check", ("^Robot: 10 kg class: six turning joints", "^Next step: calibration plan")),
    ("check a recording", ("^Recording: 486 readings", "^Next step: calibration identify")),
    ("identify", ("^Usable: yes", "^Next step: use model.yaml")),
    ("fleet", (r"2 recordings, of which 1 cannot be used\.", r"Of 2 robots of 1 type, 0 are conspicuous\.",
               r"Cannot be used: \S*gone\.csv: .*no such file", "^Next step: put right the recordings")),
])  # fmt: skip
def test_results_are_described(
    results: Path, capsys: pytest.CaptureFixture[str], command: str, said: tuple[str, ...]
) -> None:
    capsys.readouterr()
    assert run("describe", results / command) == 0
    text = capsys.readouterr().out
    for pattern in said:
        assert re.search(pattern, text, re.MULTILINE), (pattern, text)
    assert "None" not in text
    assert not re.search(r"[-−]0(\.0+)?\b(?!\.\d)", text), text


def verified(**changes: Any) -> dict[str, Any]:
    """The result of a verification, as far as it is described."""
    return {
        "schema": 1, "command": "verify", "decision": "not_conforming", "tolerance": 1e-4,
        "decision_rule": {"standard": "ISO 14253-1", "probability": 0.95},
        "error": {"after": {"mean": 2e-4, "max": 4e-4, "rms": 3e-4}, "before": None},
        "uncertainty": {"expanded": 2e-5, "coverage_factor": 2.0}, "rms_with_tracker_fitted": 2.9e-4,
        "intervals_of_the_model": False, "places": [{"configuration": k, "decision": "not_conforming"} for k in (1, 2)],
        **changes,
    }  # fmt: skip


def compared(verdict: str, **changes: Any) -> dict[str, Any]:
    row = {
        "quantity": "stiffness", "location": "joint_2", "unit": "N*m/rad", "change": -0.2, "low": -0.25, "high": -0.15,
        "verdict": verdict, "configurations": None, "limit": 0.05, "or_else": [], **changes,
    }  # fmt: skip
    return {"schema": 1, "command": "compare", "comparisons": [{"first": "a", "second": "b", "differences": [row]}]}


@pytest.mark.parametrize(("result", "said"), [
    (verified(), "The robot does not conform to the tolerance of 0.100 mm"),
    (verified(), "Of 2 configurations, 2 not conforming."),
    (verified(), "The model states no covariance"),
    (verified(usable="with_reservations", reason="it does not conform", next_step="run diagnose"),
     "Usable: with reservations. It does not conform.\nNext step: run diagnose"),
    (verified(rms_with_tracker_fitted=1e-5), "fitted to this recording, the error would be 0.010 mm rms, not 0.300 mm"),
    (verified(decision="undecided"), "leaves open whether the robot conforms"),
    (compared("changed"), "The stiffness of joint_2 has changed by −20.00 % (95 % interval −25.00 % to −15.00 %)."),
    (compared("changed", or_else=["joint_3"]), "the change may as well be at joint_3"),
    (compared("cannot_tell", configurations=40), "40 configurations each time would show it"),
    (compared("not_changed"), "Next step: none is needed"),
    (compared("changed", quantity="backlash", unit="rad", change=1e-4, low=5e-5, high=1.5e-4),
     "The backlash of joint_2 has changed by 0.00010 rad (95 % interval 0.000050 to 0.00015 rad)."),
])  # fmt: skip
def test_every_decision_has_its_sentences(result: dict[str, Any], said: str) -> None:
    assert said in "\n".join(describe(result))


@pytest.mark.parametrize("command", [*SENTENCES, "plan for geometry", "plan for verify"])
def test_what_is_no_number_is_passed_over(results: Path, command: str) -> None:
    folder = results / ("export table" if command == "export" else command)
    content = json.loads((folder / "result.json").read_text("utf-8"))
    for key in content:
        if key not in {"schema", "command"}:
            for value in (None, [], {}, "x", 10**400, [None], [{}], {"x": None}, True):
                assert describe({**content, key: value})
