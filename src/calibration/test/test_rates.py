"""A run at the rates of real drivers: joint states at 500 Hz, the wrench at 1 kHz, and what that costs."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from calibration_interfaces.msg import Outcome
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from sequencer_world import CELL, JOINTS, Operator, ended, now, overrides
from test_executables import command
from test_goal import Busy

from calibration_core.files.yaml_file import yaml_text

JOINT_RATE, WRENCH_RATE = 500.0, 1000.0  # Hz: UR e series; a sensor of ATI, Bota or SCHUNK
SHARE = 0.2  # of a core, at most
TICK = 1.0 / os.sysconf("SC_CLK_TCK")  # s


class Fast(Busy):
    """The cell with streams as fast as those of real drivers."""

    def __init__(self, spinning: Any) -> None:
        super().__init__(spinning)
        self.absent = "joint_states"  # of the slow stream
        self.wrenches = self.node.create_publisher(WrenchStamped, "input/wrench", 100)
        self.over, self.sent = threading.Event(), 0
        self.thread = threading.Thread(target=self._stream, daemon=True)
        self.thread.start()

    def _stream(self) -> None:
        rng, begun = np.random.default_rng(1), time.monotonic()
        every = round(WRENCH_RATE / JOINT_RATE)
        while not self.over.is_set():
            force = Vector3(**dict(zip("xyz", rng.normal(0.0, 0.1, 3).tolist(), strict=True)))
            self.wrenches.publish(WrenchStamped(header=now(), wrench=Wrench(force=force)))
            if self.sent % every == 0:
                self.say_joints()
            self.sent += 1
            time.sleep(max(0.0, begun + self.sent / WRENCH_RATE - time.monotonic()))


def used(process: int) -> float:
    """Processor time of a process, s."""
    fields = Path(f"/proc/{process}/stat").read_text("utf-8").rpartition(")")[2].split()
    return TICK * (int(fields[11]) + int(fields[12]))


@pytest.mark.slow  # the share of a core is measured: on a machine that does nothing else
def test_a_run_at_the_rates_of_real_drivers(
    spinning: Any, source_environment: dict[str, str], tmp_path: Path, until: Any
) -> None:
    given = {"motion.backend": "simulated", "force_torque": "force_torque/measure", "server_wait": 30.0}
    file, plan = tmp_path / "own.yaml", tmp_path / "plan.yaml"
    values = {one.name: one.value for one in overrides(**given)}
    nodes = {"/**/sequencer": values, "/**/force_torque": {"cell": CELL}}
    file.write_text(yaml_text({name: {"ros__parameters": given} for name, given in nodes.items()}), "utf-8")
    ways = [{"number": i, "q": [0.15 * (-1) ** i] * 6, "steps": [[0.0] * 6]} for i in (1, 2, 3)]
    plan.write_text(yaml_text({"schema": 1, "joints": JOINTS, "configurations": ways}), "utf-8")
    cell, operator = Fast(spinning), Operator(spinning)
    process, sensor = (
        subprocess.Popen(command(node, "--params-file", str(file)), env=source_environment)
        for node in ("sequencer", "force_torque")
    )
    try:
        assert operator.plan.wait_for_server(60.0)
        handle = operator.measure(plan, tmp_path / "session")
        assert handle.accepted, operator.refusals()
        until(lambda: cell.begun, timeout=60.0)
        began, before, sent = time.monotonic(), used(process.pid), cell.sent
        result = ended(handle, 120.0)
        took = time.monotonic() - began
        share, rate = (used(process.pid) - before) / took, (cell.sent - sent) / took
        print(f"\n{100 * share:.0f} % of a core in {took:.0f} s; {rate:.0f} Hz of wrenches, half of it of joint states")
        assert (result.outcome.code, result.configurations_done) == (Outcome.OK, 3), result.outcome.text
        assert share < SHARE
    finally:
        cell.over.set()
        cell.thread.join()
        for one in (process, sensor):
            one.terminate()
        assert [one.wait(60.0) for one in (process, sensor)] == [0, 0]
