"""An option that cannot have an effect on the input at hand is refused in one line, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import pytest
from program import CELL, run

from calibration_core.cli import argument_parser, parse
from calibration_core.engine.command_line import stated_options

BAGS = CELL.parents[2] / "bags"
PLAN = ("plan", "--cell", "{cell}", "--no-report")
EXPORT = ("export", "--cell", "{cell}", "--model", "{model}", "--format")
COMPENSATE = ("compensate", "{task}", "--cell", "{cell}", "--model", "{model}", "--no-report")
AT_REST = ("identify", "{rest}", "--cell", "{cell}", "--no-report")
LOADED = ("identify", "{loaded}", "--cell", "{cell}", "--no-report")
VERIFY = (*PLAN, "--for", "verify", "--model", "{model}", "--tolerance", "2e-4")
GEOMETRY = (*PLAN, "--for", "geometry")
CASES = (
    (PLAN, ("--tolerance", "1e-4"), "without --for verify"),
    (PLAN, ("--risk", "0.05"), "without --for verify"),
    (PLAN, ("--accuracy", "0.01"), "without --population"),
    (PLAN, ("--type", "heavy"), "no --population"),
    (GEOMETRY, ("--risk", "0.1"), "without loads and tolerance"),
    (GEOMETRY, ("--load-levels", "0", "1"), "without loads"),
    (GEOMETRY, ("--protocol", "reversed"), "without loads"),
    (GEOMETRY, ("--load-share", "0.5"), "without loads"),
    (GEOMETRY, ("--largest-force", "100"), "without loads"),
    (GEOMETRY, ("--largest-torque", "100"), "without loads"),
    (VERIFY, ("--configurations", "18"), "5 to 8 poses"),
    (VERIFY, ("--spares", "0.5"), "5 to 8 poses"),
    (VERIFY, ("--criterion", "D"), "5 to 8 poses"),
    (VERIFY, ("--load-levels", "0", "1"), "5 to 8 poses"),
    (VERIFY, ("--protocol", "reversed"), "5 to 8 poses"),
    (AT_REST, ("--method", "equilibrium"), "on a recording at rest"),
    (AT_REST, ("--method", "linear"), "on a recording at rest"),
    (AT_REST, ("--weights", "plain"), "on a recording at rest"),
    (AT_REST, ("--deflections", "pose"), "on a recording at rest"),
    (LOADED, ("--no-robust", "--readmit", "1:1:mp1"), "--readmit: found an option that has no effect with --no-robust"),
    (LOADED, ("--readmit", "999:1:mp1"), "expected a reading of"),
    (("deflect", "--cell", "{cell}", "--model", "{model}", "--no-report", "--q", "0 -1 1 0 1 0",
      "--wrench", "1 2 3 0 0 0"), ("--plane", "xy"), "with --no-report"),
    (COMPENSATE, ("--seed-q", "0 0 0 0 0 0"), "choose the branch"),
    (COMPENSATE, ("--axes", "tool"), "without a wrench"),
    ((*EXPORT, "dh"), ("--template", "some.yaml"), "--format ur"),
    ((*EXPORT, "dh"), ("--points", "21"), "--format table"),
    ((*EXPORT, "urdf"), ("--joints", "2", "3"), "--format table"),
    ((*EXPORT, "mjcf"), ("--q", "0 0 0 0"), "--format table"),
    ((*EXPORT, "table"), ("--template", "some.yaml"), "--format ur"),
    ((*EXPORT, "dh"), ("--range", "-1 1 -1 1"), "--format table"),
    (("fleet", "{rest}"), ("--tls", "a", "b", "c"), "without --cluster"),
    (("fleet", "{rest}", "--cluster", "tcp://127.0.0.1:9"), ("--jobs", "1"), "on a cluster"),
)  # fmt: skip


@pytest.fixture(scope="module")
def files(identified: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What the command lines above name."""
    folder = tmp_path_factory.mktemp("inputs")
    task = folder / "task.csv"
    task.write_text("q1,q2,q3,q4,q5,q6\n0.1,-1.0,1.0,0.2,0.7,0.1\n")
    plan = folder / "plan"
    asked = ("--for", "geometry", "--configurations", 20, "--spares", 0, "--no-report", "--out", plan)
    assert run("plan", "--cell", CELL, *asked) == 0
    rest = folder / "rest"
    assert run("simulate", "--cell", CELL, "--plan", plan / "plan.yaml", "--seed", 2, "--no-report", "--out", rest) == 0
    return {
        "cell": CELL,
        "model": identified / "model.yaml",
        "task": task,
        "rest": rest / "measurements.csv",
        "loaded": BAGS / "small_loaded",
    }


@pytest.mark.parametrize(("command", "option", "why"), CASES)
def test_an_option_without_effect_is_refused(
    files: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    command: tuple[str, ...],
    option: tuple[str, ...],
    why: str,
) -> None:
    out = tmp_path / "out"
    assert run(*(word.format(**files) for word in command), *option, "--out", out) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert [word for word in option if word.startswith("--")][-1] in said.err
    assert why in said.err
    assert not out.exists()


@pytest.mark.parametrize(("command", "option"), [
    (LOADED, ("--method", "linear", "--weights", "plain", "--readmit", "1:1:mp1")),
    (COMPENSATE, ("--axes", "tool", "--wrench", "0 0 -50 0 0 0")),
    ((*EXPORT, "table"), ("--joints", "2", "3", "--points", "3")),
])  # fmt: skip
def test_the_same_option_is_taken_where_it_has_an_effect(
    files: dict[str, Path], tmp_path: Path, command: tuple[str, ...], option: tuple[str, ...]
) -> None:
    assert run(*(word.format(**files) for word in command), *option, "--out", tmp_path / "out") == 0


def test_options_are_stated_by_any_of_their_names_and_with_their_default() -> None:
    line = ["plan", "--cell", "a.yaml", "--conf", "18", "-q"]
    assert stated_options(argument_parser(), line) == {"--cell", "--configurations", "--quiet"}
    assert parse(["identify", "a", "b", "--cell", "c", "--read", "1:1:a"]).stated == {"--cell", "--readmit"}
