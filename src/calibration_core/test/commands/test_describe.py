"""What every command prints stands in its result, and `describe` repeats it: numbers, decision, next step."""

from __future__ import annotations

import argparse
import contextlib
import io
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

PULL = ("--wrench", "50 0 -60 0 0 1")
PLACES = re.compile(r"(report|result|recording|plan|drawing|predictions|targets|deflections|certificate): |.+ as \w+: ")
POSTURE = "0.1 0.5 0.2 0.3 0.7 0.1"


@pytest.fixture(scope="module")
def results(identified: Path, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, tuple[Path, str]]:
    """Kind of result -> its folder and what was printed: every command, purpose of a plan, and format."""
    folder, common = tmp_path_factory.mktemp("described"), ("--cell", CELL, "--no-report")
    model, other = ("--model", identified / "model.yaml"), folder / "simulate" / "measurements.csv"
    task, plant = folder / "task.csv", folder / "plant.csv"
    task.write_text(f"q1,q2,q3,q4,q5,q6\n{POSTURE.replace(' ', ',')}\n7,7,7,7,7,7\n")
    plant.write_text(
        "recording,cell,robot,type,date\n"
        + "".join(f"simulate/{name},{CELL},{name},small,2026-01-05\n" for name in ("recording", "gone.csv"))
    )
    bare = ("--no-report",)
    found = {}
    for out, arguments in {
        "simulate": ("simulate", "--seed", 8, *common),
        "identify": ("identify", other, *common),
        "diagnose": ("diagnose", other, *common),
        "verify": ("verify", other, *model, "--tolerance", "1e-4", *common),
        "compare": ("compare", identified, other, *common),
        "predict": ("predict", other, *model, *common),
        "deflect": ("deflect", *model, *PULL, "--q", POSTURE, *common),
        "compensate": ("compensate", task, *model, *PULL, *common),
        "init": ("init", next(iter(library()))),
        "check": ("check", CELL, *bare),
        "check a recording": ("check", CELL, other, *bare),
        "import": ("import", other),
        "fleet": ("fleet", plant, "--jobs", 1, *bare),
        "plan": ("plan", "--configurations", 12, "--phases", *common),
        "pendant": ("pendant", folder / "plan" / "plan.yaml", "--cell", CELL, "--maker", "abb"),
        "plan for geometry": ("plan", "--for", "geometry", "--configurations", 14, *common),
        "plan for verify": ("plan", "--for", "verify", *model, "--tolerance", "2e-3", *common),
        **{f"export {form}": ("export", "--format", form, *model, "--cell", CELL)
           for form in ("urdf", "dh", "mjcf", "table")},
    }.items():  # fmt: skip
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert run(*arguments, "--out", folder / out) == 0, out
        found[out] = (folder / out, printed.getvalue())
    return found


def choices(command: str, option: str) -> set[str]:
    """The values that an option of a command takes."""
    return {str(one) for action in subparsers()[command]._actions if option in action.option_strings
            for one in action.choices or ()}  # fmt: skip


def subparsers() -> Mapping[str, argparse.ArgumentParser]:
    (found,) = (one for one in argument_parser()._actions if isinstance(one, argparse._SubParsersAction))
    return found.choices


def test_every_result_holds_what_its_command_prints(
    results: Mapping[str, tuple[Path, str]], capsys: pytest.CaptureFixture[str]
) -> None:
    """A new command, purpose of a plan or format of an export fails here until its result holds a summary."""
    assert {kind.partition(" ")[0] for kind in results} == set(subparsers()) - {*WITHOUT_RESULT}
    formats = choices("export", "--format") - {"ur"}  # which needs a template
    assert {f"export {form}" for form in formats} <= set(results)
    assert {f"plan for {purpose}" for purpose in choices("plan", "--for")} - {"plan for stiffness"} <= set(results)
    for kind, (folder, printed) in results.items():
        summary = json.loads((folder / "result.json").read_text("utf-8"))["summary"]
        said = [line for line in printed.splitlines() if not PLACES.match(line)]
        assert [line for line in summary if not PLACES.match(line)] == said, kind
        assert run("describe", folder) == 0
        title, *lines = capsys.readouterr().out.splitlines()
        assert title.startswith(folder.name.partition(" ")[0]), kind
        assert lines == summary, kind
        words = re.sub(r"(?<!\S)/\S+", "", "\n".join(summary))  # words are judged, not the places of files
        assert not re.search(r"\bNone\b|\bnan\b|[-−]0(\.0+)?\b(?!\.\d)", words), (kind, words)


@pytest.mark.parametrize("kind", ["init", "check", "check a recording", "import", "plan", "plan for verify"])
def test_a_preparation_ends_with_the_command_that_follows(results: Mapping[str, tuple[Path, str]], kind: str) -> None:
    assert re.search(r"^next: .*calibration (check|plan|identify|verify) ", results[kind][1], re.MULTILINE)


@pytest.mark.parametrize(("content", "found"), [
    ({"schema": 1, "command": "identify", "robot": "R"}, "summary: found none"),
    ({"schema": 1, "command": "identify", "summary": "x"}, "summary: found none"),
    ({"schema": 7, "command": "identify", "summary": []}, "schema: found 7,"),
    ([], "schema: found [],"),
])  # fmt: skip
def test_what_holds_no_summary_is_refused(
    content: Any, found: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps(content), "utf-8")
    assert run("describe", path) == 2
    assert found in capsys.readouterr().err
