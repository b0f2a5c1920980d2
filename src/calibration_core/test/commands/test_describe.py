"""What `describe` says of results: the decision, the numbers with their units and intervals, and the next step."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from program import CELL, run

from calibration_core.commands.files.describe import describe

PULL = ("--wrench", "50 0 -60 0 0 1")
POSTURE = "0.1 0.5 0.2 0.3 0.7 0.1"


@pytest.fixture(scope="module")
def results(identified: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder of results for each command."""
    folder, common = tmp_path_factory.mktemp("described"), ("--cell", CELL, "--no-report", "-q")
    model, other = ("--model", identified / "model.yaml"), folder / "made" / "measurements.csv"
    task = folder / "task.csv"
    task.write_text(f"q1,q2,q3,q4,q5,q6\n{POSTURE.replace(' ', ',')}\n7,7,7,7,7,7\n")
    for out, arguments in {
        "made": ("simulate", "--seed", 8),
        "verify": ("verify", other, *model, "--tolerance", "1e-4"),
        "compare": ("compare", identified, other),
        "predict": ("predict", other, *model),
        "deflect": ("deflect", *model, *PULL, "--q", POSTURE),
        "compensate": ("compensate", task, *model, *PULL),
    }.items():
        assert run(*arguments, *common, "--out", folder / out) == 0, out
    return folder


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
    (verified(), "Next step: run diagnose with this recording and the model"),
    (verified(rms_with_tracker_fitted=1e-5), "run verify again with --fit-tracker"),
    (verified(decision="undecided"), "leaves open whether the robot conforms"),
    (verified(decision="undecided"), "Next step: measure with less uncertainty"),
    (compared("changed"), "The stiffness of joint_2 has changed by −20.00 % (95 % interval −25.00 % to −15.00 %)."),
    (compared("changed"), "Next step: find out what was done to the robot"),
    (compared("changed", or_else=["joint_3"]), "the change may as well be at joint_3"),
    (compared("cannot_tell", configurations=40), "40 configurations each time would show it"),
    (compared("cannot_tell", configurations=40), "Next step: measure 40 configurations each time"),
    (compared("not_changed"), "Next step: none is needed"),
    (compared("changed", quantity="backlash", unit="rad", change=1e-4, low=5e-5, high=1.5e-4),
     "The backlash of joint_2 has changed by 0.00010 rad (95 % interval 0.000050 to 0.00015 rad)."),
])  # fmt: skip
def test_every_decision_has_its_sentences(result: dict[str, Any], said: str) -> None:
    assert said in "\n".join(describe(result))


@pytest.mark.parametrize("command", ["verify", "compare", "compensate", "deflect", "predict"])
def test_what_is_no_number_is_passed_over(results: Path, command: str) -> None:
    content = json.loads((results / command / "result.json").read_text("utf-8"))
    for key in content:
        if key not in {"schema", "command"}:
            for value in (None, [], {}, "x", 10**400, [None], [{}], {"x": None}, True):
                assert describe({**content, key: value})
