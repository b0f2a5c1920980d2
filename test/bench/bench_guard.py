"""The guard fed with 10,000 random sequences of messages, against an independent statement of its rules."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
TEST = "src/calibration_core/test/procedure/test_guard.py::test_never_a_permission_that_the_rules_forbid"
SEQUENCES = 10_000


def test_guard() -> None:
    environment = {**os.environ, "GUARD_SEQUENCES": str(SEQUENCES)}
    start = time.perf_counter()
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "--hypothesis-show-statistics", TEST]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    took = time.perf_counter() - start
    said = [line.strip() for line in done.stdout.splitlines() if "passing examples" in line]
    print(f"\nguard: {SEQUENCES} random sequences in {took:.0f} s, no permission against the rules; {' '.join(said)}")
    assert done.returncode == 0, done.stdout[-3000:]
