"""What a command shows while it runs, and the forms of its answer."""

from __future__ import annotations

import argparse
import io
import json
import os
import pty
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

from calibration_core.cli import EXAMPLES, SECTIONS, argument_parser, main, parse
from calibration_core.commands import NAMES
from calibration_core.commands.terminal import display

ROOT = Path(__file__).resolve().parents[4]
RECORDING = ROOT / "bags" / "small_loaded"
CELL = ROOT / "config" / "cells" / "small.cell.yaml"


def test_quiet_prints_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["identify", str(RECORDING), "--cell", str(CELL), "--out", str(tmp_path / "out"), "--no-report"]
    assert main([*arguments, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main([*arguments, "--json"]) == 0
    printed = capsys.readouterr().out
    assert json.loads(printed) == json.loads((tmp_path / "out" / "result.json").read_text())


@pytest.mark.parametrize(("wrong", "right"), [("identfy", "identify"), ("imprt", "import"), ("describ", "describe")])
def test_a_misspelt_command_is_answered_with_the_nearest(
    wrong: str, right: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main([wrong])
    assert caught.value.code == 2
    told = capsys.readouterr().err
    assert f"did you mean {right}?" in told
    assert told.count("\n") == 1


def test_lines_are_shown_after_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(display, "PATIENCE", 0.05)
    plain = io.StringIO()
    with display.Display("identify", plain) as shown:
        shown.report_progress(0.0, "reading the recording")
        time.sleep(0.3)
        assert plain.getvalue() == ""  # nothing but the error, if the recording cannot be read
        shown.report_progress(0.5, "identifying")
        shown.report_progress(0.8, "drawing the report")
    shown.report_progress(0.9, "after the end")
    assert plain.getvalue().splitlines() == [
        "identify: identifying (50% done)",
        "identify: drawing the report (80% done)",
    ]


def test_a_short_command_shows_nothing() -> None:
    plain = io.StringIO()
    with display.Display("identify", plain) as shown:
        shown.report_progress(0.0, "reading the recording")
    assert plain.getvalue() == ""


SLOW = """
import sys, time
from calibration_core.commands.terminal import display
display.PATIENCE = 0.05
with display.Display("diagnose", sys.stderr) as shown:
    shown.report_progress(0.4, "looking for missing physics")
    time.sleep(0.6)
"""


def test_a_bar_is_drawn_on_a_terminal() -> None:
    leader, follower = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(
        [sys.executable, "-c", SLOW], stdout=subprocess.PIPE, stderr=follower, env=environment
    ) as run:
        os.close(follower)
        seen = b""
        while True:
            try:
                part = os.read(leader, 4096)
            except OSError:  # the other side has closed it
                break
            if not part:
                break
            seen += part
        assert run.stdout is not None
        assert run.stdout.read() == b""
    os.close(leader)
    assert run.returncode == 0
    assert b"diagnose: looking for missing physics" in seen
    assert b"left:" in seen


def test_the_program_alone_says_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    """Bare `calibration` is the help, in which every command stands once, under what it is for."""
    with pytest.raises(SystemExit) as end:
        main([])
    assert end.value.code == 0
    printed = capsys.readouterr().out
    assert printed == argument_parser().format_help()
    listed = [word for words in SECTIONS.values() for word in words]
    assert sorted(listed) == sorted(NAMES)
    assert all(f"\n  {name} " in printed for name in NAMES)
    assert all(f"\n{title}:\n" in printed for title in SECTIONS)


@pytest.mark.parametrize("name", NAMES)
def test_every_command_has_an_example_and_states_its_defaults(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    parse(shlex.split(EXAMPLES[name]))
    with pytest.raises(SystemExit):
        main([name, "--help"])
    printed = " ".join(capsys.readouterr().out.split())
    assert f"example: calibration {EXAMPLES[name]}" in printed
    (commands,) = (one for one in argument_parser()._actions if isinstance(one, argparse._SubParsersAction))
    for action in commands.choices[name]._actions:
        if action.nargs != 0 and action.default not in (None, "", [], argparse.SUPPRESS):
            value = " ".join(map(str, action.default)) if isinstance(action.default, list) else action.default
            assert f"default {value}" in printed or "(default)" in printed, action.dest
