"""The stopwatch of the tests: a bar means the same on a busy machine."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest
from granted import Granted, delays

HOG = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"  # ends with who started it


def test_it_goes_while_nothing_is_kept_waiting() -> None:
    watch = Granted()
    time.sleep(0.5)  # a process that sleeps waits for no core
    assert 0.4 < watch.seconds < 1.0


def test_it_stands_while_a_process_waits_for_a_core() -> None:
    """One that shares a core with four others gets little more than a fifth of it."""
    if not delays(os.getpid()):
        pytest.skip("the kernel does not count how long threads wait")
    core = {min(os.sched_getaffinity(0))}
    hogs = [subprocess.Popen([sys.executable, "-c", HOG]) for _ in range(5)]
    try:
        for hog in hogs:
            os.sched_setaffinity(hog.pid, core)
        time.sleep(1.0)
        watch, began = Granted(hogs[0].pid), time.monotonic()
        time.sleep(2.0)
        assert watch.seconds < 0.6 * (time.monotonic() - began)
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()
