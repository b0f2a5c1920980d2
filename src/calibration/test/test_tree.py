"""The shipped tree of processes, started and ended as `launch` does it."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Permission
from tree_runner import TreeRunner

from calibration.process_tree import SIMULATED_CELL
from calibration.topics import PERMISSION

pytestmark = pytest.mark.alone

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"
NODES = {process.name for process in SIMULATED_CELL.processes}


def test_a_crash_ends_no_other_process(
    spinning: Any, until: Any, source_environment: dict[str, str], tmp_path: Path
) -> None:
    client = spinning.plain("outside")
    runner = TreeRunner(SIMULATED_CELL, source_environment, tmp_path, cell=CELL, session=tmp_path / "session")
    try:
        runner.start()
        until(lambda: set(client.get_node_names()) >= NODES, timeout=60.0)
        runner.strike("force_torque", signal.SIGKILL)
        time.sleep(1.0)
        alive = {name for name, process in runner.running.items() if process.poll() is None}
        assert alive == NODES - {"force_torque"}
    finally:
        ended = runner.shutdown()
    assert {name: code for name, code, _ in ended} == dict.fromkeys(NODES - {"force_torque"}, 0), ended
    assert max(seconds for _, _, seconds in ended) < min(one.sigterm_after for one in SIMULATED_CELL.processes), ended


def test_a_cell_at_twenty_times_life_is_not_latched_while_idle(
    spinning: Any, until: Any, source_environment: dict[str, str], tmp_path: Path
) -> None:
    heard: list[Permission] = []
    client = spinning.plain("outside")
    client.create_subscription(Permission, PERMISSION.relative, heard.append, 100)
    said = {"cell": CELL, "session": tmp_path / "session", "speed": 20.0}
    runner = TreeRunner(SIMULATED_CELL, source_environment, tmp_path, **said)
    try:
        runner.start()
        until(lambda: heard and list(heard[-1].reasons) == [Permission.STOP_UNPROVEN], timeout=60.0)
        time.sleep(3.0)
        latched = {one.text for one in heard if one.latched}
    finally:
        runner.shutdown()
    assert latched == set()
