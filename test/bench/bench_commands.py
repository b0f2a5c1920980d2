"""Whole commands as they are run from a shell, start of the interpreter included, on real recordings.

Bars: 11,911 poses (UR10 A) in 5 s without the report; 86 readings (FANUC) in 3.5 s with it.  The commands use one
thread and hardly wait, so their processor time is the time that they take on a machine with nothing else to do.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data" / "real"
PROGRAM = Path(sys.executable).with_name("calibration")
REPEATS = 3


@pytest.mark.parametrize(
    ("recording", "options", "bar"), [("ur10_A", ("--no-report",), 5.0), ("fanuc", (), 3.5)], ids=["UR10 A", "FANUC"]
)
def test_identify(recording: str, options: tuple[str, ...], bar: float, tmp_path: Path) -> None:
    if not DATA.is_dir():
        pytest.skip(f"no real recordings in {DATA}")
    table, cell = DATA / f"{recording}.csv", DATA / f"{recording}.cell.yaml"
    command = [PROGRAM, "identify", table, "--cell", cell, "--out", tmp_path, *options]
    seconds = []
    for _ in range(REPEATS):
        start, clock = _processor(), time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        seconds.append((_processor() - start, time.perf_counter() - clock))
    took, wall = (statistics.median(column) for column in zip(*seconds, strict=True))
    name = " ".join(("calibration identify", recording, *options))
    print(f"\n{name}: {took:.1f} s of processor time (bar {bar:g} s), {wall:.1f} s by the clock on this machine")
    assert (tmp_path / "report.pdf").exists() == (not options)
    assert took < bar


def _processor() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
