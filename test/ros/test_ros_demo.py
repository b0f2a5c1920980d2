"""The demonstration: it does what it says, and leaves no process behind, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

ROOT = Path(__file__).resolve().parents[2]
MARK = "CALIBRATION_TEST"
LONGEST = 180.0  # s
INTERRUPTED_WHILE_IT_STARTS_A_PROCESS = """
import importlib.util, signal, subprocess, sys
specification = importlib.util.spec_from_file_location("demo", sys.argv[1])
demo = importlib.util.module_from_spec(specification)
specification.loader.exec_module(demo)

class Interrupted(subprocess.Popen):
    def __init__(self, *given, **more):
        super().__init__(*given, **more)
        signal.raise_signal(signal.SIGTERM)

subprocess.Popen = Interrupted
for number in demo.SIGNALS:
    signal.signal(number, demo.leave)
processes = demo.Processes()
try:
    processes.start(["sleep", "60"])
finally:
    processes.stop()
"""


class Demonstration:
    """The demonstration under way; whatever it starts inherits a mark."""

    def __init__(self, environment: dict[str, str], out: Path) -> None:
        self.out, self.mark = out, str(uuid.uuid4())
        self.process = subprocess.Popen(
            [sys.executable, str(ROOT / ".ci" / "demo.py"), str(out)], env={**environment, MARK: self.mark},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        )  # fmt: skip

    def wait_for(self, path: Path, seconds: float) -> None:
        end = time.monotonic() + seconds
        while not path.exists():
            assert self.process.poll() is None, self.output()
            assert time.monotonic() < end, f"no {path}"
            time.sleep(0.05)

    def output(self) -> str:
        """What it said, once it is over."""
        assert self.process.stdout is not None
        return self.process.stdout.read()


@pytest.fixture
def demonstration(source_environment: dict[str, str], tmp_path: Path) -> Iterator[Demonstration]:
    one = Demonstration(source_environment, tmp_path / "demo")
    yield one
    if one.process.poll() is None:
        one.process.send_signal(signal.SIGTERM)
        one.process.wait(30.0)


@pytest.mark.parametrize(
    ("number", "moment"),
    [
        (signal.SIGTERM, "plan"),
        (signal.SIGINT, "sequencer.log"),
        (signal.SIGTERM, "session/session.db"),
        pytest.param(signal.SIGHUP, "identify", marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, "replay", marks=pytest.mark.slow),
    ],
)
def test_interrupted(demonstration: Demonstration, still_running: Any, number: signal.Signals, moment: str) -> None:
    demonstration.wait_for(demonstration.out / moment, 300.0)
    time.sleep(0.3)
    assert len(still_running(demonstration.mark)) > 1
    demonstration.process.send_signal(number)
    assert demonstration.process.wait(30.0) == 128 + number, demonstration.output()
    assert still_running(demonstration.mark) == []


def test_interrupted_while_it_starts_a_process(source_environment: dict[str, str], still_running: Any) -> None:
    mark = str(uuid.uuid4())
    command = [sys.executable, "-c", INTERRUPTED_WHILE_IT_STARTS_A_PROCESS, str(ROOT / ".ci" / "demo.py")]
    done = subprocess.run(command, check=False, env={**source_environment, MARK: mark}, timeout=60.0)
    assert done.returncode == 128 + signal.SIGTERM
    assert still_running(mark) == []


@pytest.mark.slow
def test_a_measurement_that_waits_for_an_operator_ends(demonstration: Demonstration, marked_processes: Any) -> None:
    """A cell that stood still for seconds, as on a busy machine, loses the permission; nobody resumes the motion."""
    demonstration.wait_for(demonstration.out / "session/session.db", 300.0)
    time.sleep(8.0)
    (cell,) = [pid for pid, words in marked_processes(demonstration.mark).items() if "simulated_cell" in words]
    os.kill(cell, signal.SIGSTOP)
    time.sleep(6.0)
    os.kill(cell, signal.SIGCONT)
    began = time.monotonic()
    assert demonstration.process.wait(90.0) == 1
    assert time.monotonic() - began < 60.0
    output = demonstration.output()
    assert "the measurement waits for an operator: " in output
    assert "too busy" in output, output
    assert marked_processes(demonstration.mark) == {}


@pytest.mark.slow
def test_to_the_end(demonstration: Demonstration, still_running: Any) -> None:
    began = time.monotonic()
    output = demonstration.output()
    took = time.monotonic() - began
    print(f"\ntook {took:.0f} s\n{output}")
    assert demonstration.process.wait(10.0) == 0
    assert "live and replayed results are the same to the bit" in output
    assert "the diagnosis names it" in output
    for line in output.splitlines():
        if line.startswith("report, "):
            assert Path(line.partition(": ")[2]).is_file(), line
    assert output.count("\nreport, ") == 4  # of the plan, the stiffness and both diagnoses
    assert still_running(demonstration.mark) == []
    assert took < LONGEST
