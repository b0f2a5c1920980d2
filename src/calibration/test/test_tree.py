"""The shipped tree of processes, started and ended as `launch` does it."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Permission
from test_security import agrees
from tree_runner import TreeRunner

from calibration.process_tree import SIMULATED_CELL
from calibration.topics import PERMISSION

pytestmark = pytest.mark.alone

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"
NODES = {process.name for process in SIMULATED_CELL.processes}


def test_the_shipped_tree(spinning: Any, until: Any, source_environment: dict[str, str], tmp_path: Path) -> None:
    """At twenty times life: nothing is latched while it is idle, policy and nodes agree, a crash ends no other node."""
    heard: list[Permission] = []
    client = spinning.plain("outside")
    client.create_subscription(Permission, PERMISSION.relative, heard.append, 100)
    said = {
        "cell": CELL,
        "session": tmp_path / "session",
        "speed": 20.0,
        "tracker": "stream",
    }  # the policy knows its topics
    runner = TreeRunner(SIMULATED_CELL, source_environment, tmp_path, **said)
    try:
        runner.start()
        until(lambda: heard and list(heard[-1].reasons) == [Permission.STOP_UNPROVEN], timeout=120.0)
        agrees(client)  # for seconds in which nothing changes
        latched = {one.text for one in heard if one.latched}
        runner.strike("force_torque", signal.SIGKILL)
        time.sleep(1.0)
        alive = {name for name, process in runner.running.items() if process.poll() is None}
    finally:
        ended = runner.shutdown()
    assert latched == set()
    assert alive == NODES - {"force_torque"}
    assert {name: code for name, code, _ in ended} == dict.fromkeys(NODES - {"force_torque"}, 0), ended
    assert max(seconds for _, _, seconds in ended) < min(one.sigterm_after for one in SIMULATED_CELL.processes), ended
