"""A disk that runs full in the middle of a measurement: the run ends in words that name the file and the room."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from calibration_interfaces.msg import Outcome
from std_srvs.srv import Trigger

SMALL = 'mount -t tmpfs -o size=1m none "$1" && shift && exec "$@"'
MOUNTED = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", SMALL, "sh"]


def test_the_run_ends_in_words(suite: Any, short_plan: Path) -> None:
    disk = suite.session
    disk.mkdir()
    if shutil.which("unshare") is None or subprocess.run([*MOUNTED, disk, "true"], check=False).returncode:
        pytest.skip("no small disk can be made: mounting in a user namespace is not permitted here")
    suite.start_fast()
    suite.end("sequencer")
    suite.given["sequencer"] = [*MOUNTED, str(disk), *suite.given["sequencer"], "-p", "recorder:=''"]
    suite.again("sequencer")
    run = suite.run(short_plan)
    time.sleep(3.0)
    inside = Path(f"/proc/{suite.processes['sequencer'].pid}/root{disk}")  # the disk as the sequencer sees it
    with (inside / "filler").open("wb", buffering=0) as filler, contextlib.suppress(OSError):
        while True:
            filler.write(bytes(4096))
    for _ in range(200):  # every pause is noted in the session
        if run.over:
            break
        suite.call(Trigger, "sequencer/pause")
        suite.call(Trigger, "sequencer/resume")
    result = run.result(20.0)
    assert result.outcome.code == Outcome.FAULT, result.outcome.text
    assert f"{disk}/session.db: found a full disk: 0 kB of 1024 kB left" in result.outcome.text
