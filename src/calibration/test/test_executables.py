"""The installed executables: they start with the parameter file, answer, and end as they should."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from granted import Granted

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

ROOT = Path(__file__).resolve().parents[3]
BIN = ROOT / "install" / "calibration" / "lib" / "calibration"
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"


def command(name: str, *more: str) -> list[str]:
    package = "calibration_sim" if name == "simulated_cell" else "calibration"
    return [str(ROOT / "install" / package / "lib" / package / name), "--ros-args", *more]


@pytest.mark.parametrize(
    ("name", "end"),
    [("tracker", signal.SIGINT), ("force_torque", signal.SIGTERM), ("identification", signal.SIGHUP)],
)
def test_start_and_end(
    spinning: Any, until: Callable[..., None], source_environment: dict[str, str], name: str, end: signal.Signals
) -> None:
    client = spinning.plain()
    process = subprocess.Popen(command(name, "-p", f"cell:={CELL}"), env=source_environment, start_new_session=True)
    try:
        until(lambda: name in client.get_node_names(), timeout=60.0)
        watch = Granted(os.getpid(), process.pid)
        os.kill(process.pid, end)
        assert watch.until_ended(process) == 0
        assert watch.seconds < 8.0  # 2 s are the bar where nothing else runs
        with pytest.raises(ProcessLookupError):
            os.killpg(process.pid, 0)  # nor does a child stay behind
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


LAUNCH = """
import os, subprocess, sys, time
environment = {**os.environ, **({"CALIBRATION_STARTED_BY": str(os.getpid())} if sys.argv[1] == "launch" else {})}
print(subprocess.Popen(sys.argv[2:], env=environment).pid, flush=True)
time.sleep(600.0)
"""


@pytest.mark.parametrize("by", ["launch", "hand"])
def test_a_node_whose_launch_was_killed_ends_and_one_started_by_hand_goes_on(
    spinning: Any, until: Callable[..., None], source_environment: dict[str, str], tmp_path: Path, by: str
) -> None:
    client, log = spinning.plain(), tmp_path / "log"
    words = [sys.executable, "-c", LAUNCH, by, *command("tracker", "-p", f"cell:={CELL}")]
    with log.open("wb") as said:
        launch = subprocess.Popen(words, env=source_environment, stdout=subprocess.PIPE, stderr=said)
    assert launch.stdout is not None
    node = int(launch.stdout.readline())
    try:
        until(lambda: "tracker" in client.get_node_names(), timeout=60.0)
        launch.kill()
        launch.wait()
        if by == "launch":
            until(lambda: not alive(node), timeout=15.0)
            assert f"process {launch.pid}, which started this node, has ended" in log.read_text()
        else:
            time.sleep(1.0)
            assert alive(node)
            os.kill(node, signal.SIGHUP)
            until(lambda: not alive(node), timeout=15.0)
    finally:
        launch.kill()
        if alive(node):
            os.kill(node, signal.SIGKILL)


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended may still wait for somebody to hear of it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("name", ["sequencer", "simulated_cell"])
def test_a_signal_while_the_modules_are_loaded_ends_the_process(source_environment: dict[str, str], name: str) -> None:
    """Else it would raise KeyboardInterrupt somewhere in an import, which may be ignored there."""
    process = subprocess.Popen(
        command(name, "-p", f"cell:={CELL}"), env=source_environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    try:
        end = time.monotonic() + 30.0
        while not caught(process.pid) >> signal.SIGTERM - 1 & 1:  # the interpreter itself leaves it to the system
            assert time.monotonic() < end
            time.sleep(0.002)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=10.0)
        assert (process.returncode, said) == (0, b"")
    finally:
        process.kill()
        process.wait()


def caught(pid: int) -> int:
    """The signals that a process handles, a bit each."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    return int(next(line for line in status.splitlines() if line.startswith("SigCgt:")).split()[1], 16)


@pytest.mark.parametrize(
    ("name", "more", "words"),
    [
        ("tracker", ("-p", f"cell:={CELL}", "-p", "unit:=mm"), "unit: found an unknown parameter, expected one of"),
        ("simulated_cell", (), "cell: found nothing, expected the cell file: --ros-args -p cell:=FILE\n"),
        ("recorder", ("-p", "cell:=/no/such.yaml", "-p", "out:=/no/such"), "/no/such.yaml"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_2(
    source_environment: dict[str, str], name: str, more: tuple[str, ...], words: str
) -> None:
    answer = subprocess.run(
        command(name, *more), env=source_environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert answer.returncode == 2, answer.stderr
    assert words in answer.stderr
    assert answer.stderr.count("\n") == 1


def test_an_unknown_node_in_the_parameter_file(source_environment: dict[str, str], tmp_path: Path) -> None:
    file = tmp_path / "ros.yaml"
    file.write_text("traker: {ros__parameters: {cell: x}}\n", "utf-8")
    answer = subprocess.run(
        [str(BIN / "tracker"), "--ros-args", "--params-file", str(file)],
        env=source_environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert answer.returncode == 2
    assert "traker: found an unknown node" in answer.stderr
