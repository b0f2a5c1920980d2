"""The tree of processes is started and ended where there is neither `launch` nor `ros2`."""

from __future__ import annotations

import dataclasses
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from calibration import without_launch
from calibration.process_tree import SIMULATED_CELL
from calibration.without_launch import asked_of, main

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"
NODE = """#!/bin/sh
trap 'echo ended >> "$0.log"; exit 0' INT
echo "$@" > "$0.log"
while true; do sleep 0.05; done
"""
DEAF = NODE.replace("INT", "HUP").replace("#!/bin/sh", "#!/bin/sh\ntrap '' INT")


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[str]]:
    """Put scripts in the place of two nodes; return the words that start them."""

    def make(**scripts: str) -> list[str]:
        rows = [one for one in SIMULATED_CELL.processes if one.name in scripts]
        for row in rows:
            path = tmp_path / "lib" / row.package / row.name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(scripts[row.name])
            path.chmod(0o755)
        quick = tuple(dataclasses.replace(row, sigterm_after=0.5, sigkill_after=0.5) for row in rows)
        small = dataclasses.replace(SIMULATED_CELL, processes=quick)
        monkeypatch.setitem(without_launch.TREES, "simulated_cell", small)
        monkeypatch.setattr(without_launch, "get_package_prefix", lambda _: str(tmp_path))
        monkeypatch.setattr(without_launch, "get_package_share_directory", lambda _: str(tmp_path))
        return ["simulated_cell", f"cell:={CELL}", f"session:={tmp_path / 'today'}", "speed:=20.0"]

    return make


def until_there(*paths: Path) -> None:
    end = time.monotonic() + 30.0
    while not all(path.is_file() for path in paths):
        assert time.monotonic() < end, paths
        time.sleep(0.02)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_process_is_started_with_its_parameters_and_ended(
    number: int, tree: Callable[..., list[str]], tmp_path: Path
) -> None:
    words = tree(guard=NODE, simulated_cell=NODE)
    logs = [tmp_path / "lib" / place for place in ("calibration/guard.log", "calibration_sim/simulated_cell.log")]

    def press() -> None:
        until_there(*logs)
        os.kill(os.getpid(), number)

    before = signal.getsignal(signal.SIGINT)
    threading.Thread(target=press).start()
    assert main(words) == 0
    assert signal.getsignal(signal.SIGINT) == before
    for log in logs:
        assert log.read_text().splitlines()[-1] == "ended"
    given = logs[1].read_text()
    assert "--params-file" in given
    assert "config/simulation.yaml" in given  # for it lives faster than life
    assert "-p speed:=20.0" in given
    assert "motion.backend:=simulated" in logs[0].read_text()


def test_a_deaf_process_is_ended_after_its_time(tree: Callable[..., list[str]], tmp_path: Path) -> None:
    words = tree(guard=DEAF)

    def press() -> None:
        until_there(tmp_path / "lib" / "calibration" / "guard.log")
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=press).start()
    began = time.monotonic()
    assert main(words) == 0
    assert time.monotonic() - began < 20.0


CRASHES_ONCE = """#!/bin/sh
echo started >> "$0.log"
if [ "$(wc -l < "$0.log")" -gt 1 ]; then exit 0; fi
kill -9 $$
"""


def test_a_node_that_was_killed_is_started_again_and_one_that_was_told_to_end_is_not(
    tree: Callable[..., list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(without_launch, "AGAIN_AFTER", 0.1)
    assert main(tree(guard=CRASHES_ONCE)) == 0
    assert (tmp_path / "lib" / "calibration" / "guard.log").read_text().splitlines() == ["started"] * 2
    assert capsys.readouterr().err == "guard ended with -9, and is started again\n"


def test_a_simulated_cell_that_was_killed_stays_dead(tree: Callable[..., list[str]], tmp_path: Path) -> None:
    """It stands for the robot, and its clock would begin anew."""
    assert main(tree(simulated_cell=CRASHES_ONCE)) == -9
    assert (tmp_path / "lib" / "calibration_sim" / "simulated_cell.log").read_text().splitlines() == ["started"]


def test_where_nothing_is_left_it_ends_and_says_so(tree: Callable[..., list[str]]) -> None:
    assert main(tree(guard="#!/bin/sh\nexit 2\n")) == 2


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ([], "arguments: found nothing, expected one of real_cell, simulated_cell, replay"),
        (["real"], "arguments: found 'real', expected one of"),
        (["real_cell", "cell=x"], "arguments: real_cell: found 'cell=x', expected NAME:=VALUE with one of cell, "),
        (["real_cell", "sell:=x"], "arguments: real_cell: found 'sell:=x', expected NAME:=VALUE with one of cell, "),
        (["real_cell", "cell:=gone.yaml"], "arguments: cell: found no file gone.yaml, expected"),
        (["replay", f"cell:={CELL}", "recording:=bag"], "arguments: replay: found no command `ros2`, expected"),
    ],
)
def test_arguments_that_make_no_sense_are_one_line(
    words: list[str], found: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.err.startswith(found)
    assert (said.out, said.err.count("\n")) == ("", 1)


@pytest.mark.parametrize("words", [["--help"], ["-h"], *([name, "--help"] for name in without_launch.TREES)])
def test_help_states_every_argument_with_its_default(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 0
    shown, error = capsys.readouterr()
    assert error == ""
    assert shown.startswith("usage: python -m calibration.without_launch ")
    assert max(map(len, shown.splitlines())) <= 120
    text = " ".join(shown.split())
    asked = [name for name in without_launch.TREES if name in words] or list(without_launch.TREES)
    for name, tree in without_launch.TREES.items():
        assert (f"arguments of {name}:" in text) == (name in asked)
        for argument in tree.arguments if name in asked else ():
            default = "must be given" if argument.default is None else f"default {argument.default or 'empty'}"
            among = f", one of {', '.join(argument.choices)}" if argument.choices else ""
            assert f"{argument.name}:= {argument.description} ({default}{among})" in text


def test_the_trees_are_those_of_the_launch_files() -> None:
    files = (Path(__file__).resolve().parents[1] / "launch").glob("*.launch.py")
    assert set(without_launch.TREES) == {path.name.removesuffix(".launch.py") for path in files}
    tree, values = asked_of(["simulated_cell", f"cell:={CELL}", "session:=today"])
    assert tree is SIMULATED_CELL
    assert values["speed"] == "1.0"
