"""Nothing is lost between publisher and bag, gaps are counted exactly, memory stays flat.

Streams: 1 kHz wrench, 500 Hz joint states, three points at 100 Hz; publisher, recorder and force/torque node are
processes of their own.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import SampleCheck

from calibration_core.cell import load_cell
from calibration_core.recording.bags.bag import read_bag

pytestmark = [pytest.mark.alone, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[3]
BIN = ROOT / "install" / "calibration" / "lib" / "calibration"
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
PAGE = os.sysconf("SC_PAGE_SIZE")

PUBLISH = """
import sys, time
import numpy as np, rclpy
from granted import Granted
from geometry_msgs.msg import PointStamped, WrenchStamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
seconds, names = float(sys.argv[1]), sys.argv[2].split(",")
skipped = {int(one) for one in sys.argv[3].split(",")}
receivers = [int(one) for one in sys.argv[4:]]
rclpy.init()
node = rclpy.create_node("publisher")
qos = QoSProfile(depth=2000)
wrench = node.create_publisher(WrenchStamped, "input/wrench", qos)
direct = node.create_publisher(WrenchStamped, "force_torque/wrench", qos)
joints = node.create_publisher(JointState, "joint_states", qos)
points = [node.create_publisher(PointStamped, f"tracker/mp{k}", qos) for k in (1, 2, 3)]
while min(p.get_subscription_count() for p in (wrench, direct, joints, *points)) == 0:
    rclpy.spin_once(node, timeout_sec=0.05)
time.sleep(0.5)
W, J, P = WrenchStamped(), JointState(name=names, position=[0.0] * len(names)), PointStamped()
start, waited = time.monotonic(), 0.0
watches = [Granted(one) for one in receivers]
for k in range(int(1000 * seconds)):
    if k % 100 == 0:
        # While a receiver has no core, nothing is sent: its queues hold two seconds.
        waited = max(watch.waited for watch in watches)
    pause = start + waited + k * 1e-3 - time.monotonic()
    if pause > 0:
        time.sleep(pause)
    sec, nanosec = 1700000000 + k // 1000, k % 1000 * 1000000
    for message in (W, J, P):
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    W.wrench.force.x = float(k)
    direct.publish(W)
    if k not in skipped:
        wrench.publish(W)
    if k % 2 == 0:
        J.position[0] = float(k)
        joints.publish(J)
    if k % 10 == 0:
        P.point.x = float(k)
        for publisher in points:
            publisher.publish(P)
print("late", time.monotonic() - start - waited - seconds, "waited", waited, flush=True)
time.sleep(1.0)
"""


def memory(process: subprocess.Popen[Any]) -> int:
    """Resident memory, bytes."""
    return int(Path(f"/proc/{process.pid}/statm").read_text("ascii").split()[1]) * PAGE


def soak(
    seconds: float, spinning: Any, until: Callable[..., None], tmp_path: Path, environment: dict[str, str]
) -> dict[str, float]:
    cell = load_cell(CELL)
    rng = np.random.default_rng(1)
    total = int(1000 * seconds)
    begins = np.sort(rng.choice(np.arange(100, total - 100, 50), max(int(seconds), 5), replace=False))
    lengths = rng.integers(1, 20, len(begins))
    skipped = [int(b) + k for b, n in zip(begins, lengths, strict=True) for k in range(n)]
    heard: list[SampleCheck] = []
    spinning.plain().create_subscription(SampleCheck, "/calibration/sample_check", heard.append, 100)
    common = ["--ros-args", "-p", f"cell:={CELL}"]
    recorder = subprocess.Popen([str(BIN / "recorder"), *common, "-p", f"out:={tmp_path / 'bag'}"], env=environment)
    sensor = subprocess.Popen(
        [str(BIN / "force_torque"), *common, "-r", "force_torque/wrench:=unused/wrench",
         "-p", "largest_force:=1.0e9"], env=environment,
    )  # fmt: skip
    names = ",".join(cell.robot.joints)
    receivers = [str(one.pid) for one in (recorder, sensor)]
    arguments = [sys.executable, "-c", PUBLISH, str(seconds), names, ",".join(map(str, skipped)), *receivers]
    path = os.pathsep.join([str(Path(__file__).parent), *filter(None, [environment.get("PYTHONPATH")])])
    publisher = subprocess.Popen(arguments, env={**environment, "PYTHONPATH": path}, stdout=subprocess.PIPE, text=True)
    running = [recorder, sensor, publisher]
    try:
        until(lambda: heard and heard[-1].received > total // 5, timeout=120.0 + 20.0 * seconds)
        early = [memory(recorder), memory(sensor)]
        assert publisher.stdout is not None
        late = float(publisher.stdout.readline().split()[1])
        grown = [memory(one) / before - 1.0 for one, before in zip((recorder, sensor), early, strict=True)]
        until(lambda: heard[-1].received >= total - len(skipped), timeout=60.0)
        publisher.wait(30.0)
        recorder.send_signal(signal.SIGINT)
        sensor.send_signal(signal.SIGINT)
        assert recorder.wait(10.0) == 0
        assert sensor.wait(10.0) == 0
    finally:
        for one in running:
            if one.poll() is None:
                one.kill()
                one.wait()
    back = read_bag(tmp_path / "bag", cell)
    assert back.wrench is not None
    np.testing.assert_array_equal(back.wrench.values[:, 0], np.arange(total, dtype=float))
    np.testing.assert_array_equal(back.joints.values[:, 0], np.arange(0, total, 2, dtype=float))
    for name in cell.points:
        np.testing.assert_array_equal(back.points[name].values[:, 0], np.arange(0, total, 10, dtype=float))
    last = heard[-1]
    assert (last.gaps, last.missing) == (len(begins), len(skipped))
    assert last.accepted == last.received == total - len(skipped)
    return {"late": late, "recorder": grown[0], "force_torque": grown[1]}


def test_soak(spinning: Any, until: Callable[..., None], tmp_path: Path, source_environment: dict[str, str]) -> None:
    found = soak(600.0, spinning, until, tmp_path, source_environment)
    print(found)
    assert found["recorder"] < 0.05
    assert found["force_torque"] < 0.05
