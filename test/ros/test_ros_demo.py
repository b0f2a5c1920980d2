"""The demonstration: it does what it says, and leaves no process behind, however it ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

ROOT = Path(__file__).resolve().parents[2]
MARK = "CALIBRATION_DEMONSTRATION"
LONGEST = 180.0  # s


class Demonstration:
    """The demonstration under way; whatever it starts inherits a mark."""

    def __init__(self, environment: dict[str, str], out: Path) -> None:
        self.out, self._mark = out, str(uuid.uuid4())
        self.process = subprocess.Popen(
            [sys.executable, str(ROOT / ".ci" / "demo.py"), str(out)], env={**environment, MARK: self._mark},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        )  # fmt: skip

    def left(self) -> list[str]:
        """Command lines of processes that still run."""
        found = []
        for path in Path("/proc").glob("[0-9]*"):
            try:
                marked = f"{MARK}={self._mark}".encode() in (path / "environ").read_bytes().split(b"\0")
                words = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:  # it ended meanwhile, or is another user's
                continue
            if marked and words:
                found.append(words)
        return found

    def wait_for(self, path: Path, seconds: float) -> None:
        end = time.monotonic() + seconds
        while not path.exists():
            assert self.process.poll() is None, self.told()
            assert time.monotonic() < end, f"no {path}"
            time.sleep(0.05)

    def told(self) -> str:
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
def test_interrupted(demonstration: Demonstration, number: signal.Signals, moment: str) -> None:
    demonstration.wait_for(demonstration.out / moment, 300.0)
    time.sleep(0.3)
    assert len(demonstration.left()) > 1
    demonstration.process.send_signal(number)
    assert demonstration.process.wait(30.0) == 128 + number, demonstration.told()
    assert demonstration.left() == []


@pytest.mark.slow
def test_to_the_end(demonstration: Demonstration) -> None:
    began = time.monotonic()
    told = demonstration.told()
    took = time.monotonic() - began
    print(f"\ntook {took:.0f} s\n{told}")
    assert demonstration.process.wait(10.0) == 0
    assert "live and replayed results are the same to the bit" in told
    assert "the diagnosis names it" in told
    for line in told.splitlines():
        if line.startswith("report, "):
            assert Path(line.partition(": ")[2]).is_file(), line
    assert told.count("\nreport, ") == 3
    assert demonstration.left() == []
    assert took < LONGEST
