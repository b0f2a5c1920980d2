"""The page under load, and whom it disturbs: on the shipped tree in a real browser; slow, see `make prove-panel`."""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Outcome, Permission, SampleCheck, State
from calibration_interfaces.srv import Record
from panel_cell import CELL, LONG, browser, running
from rclpy.serialization import serialize_message

from calibration.topics import PERMISSION, SAMPLE_CHECK, STATE
from calibration_core.cell import load_cell
from calibration_core.recording.bags.bag import read_bag
from calibration_core.timeseries import NANOSECONDS

pytestmark = pytest.mark.slow

FLOOD = 2000.0  # states a second


class Flood:
    """A stranger who publishes states, again and again, from processes of their own."""

    CODE = """
import os, signal, sys, time
import rclpy
from calibration.topics import STATE
rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
node = rclpy.create_node("stranger")
publisher = node.create_publisher(STATE.message, STATE.relative, STATE.qos)
message = open(sys.argv[1], "rb").read()
ended = []
signal.signal(signal.SIGTERM, lambda *_: ended.append(time.monotonic()))
print("begins", flush=True)
begun, sent, parent = time.monotonic(), 0, os.getppid()
while not ended and os.getppid() == parent:
    publisher.publish(message)
    sent += 1
    time.sleep(max(0.0, begun + sent / float(sys.argv[2]) - time.monotonic()))
print(sent / (time.monotonic() - begun))
"""

    def __init__(self, environment: dict[str, str], file: Path, rate: float) -> None:
        command = [sys.executable, "-c", self.CODE, str(file), str(rate)]
        self._process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)

    def begun(self) -> None:
        """Wait until it sends."""
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "begins\n"

    def stop(self) -> float:
        """End it; return how many it has sent in a second."""
        self._process.terminate()
        return float(self._process.communicate(timeout=LONG)[0])


def resident(process: int) -> float:
    """Memory of a process, MB."""
    text = Path(f"/proc/{process}/status").read_text("utf-8")
    return int(re.findall(r"VmRSS:\s+(\d+) kB", text)[0]) / 1024


INTERACTION = """async () => {
  const took = [];
  for (let n = 0; n < 40; n += 1) {
    const name = ["before", "during", "after"][n % 3];
    const began = performance.now();
    document.getElementById(`tab_${name}`).click();
    await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
    if (document.getElementById(name).hidden) throw new Error(name);
    took.push(performance.now() - began);
  }
  return took.sort((a, b) => a - b);
}"""
ROUND = """async () => {
  const took = [];
  for (let n = 0; n < 15; n += 1) {
    const began = performance.now();
    const answer = await fetch("/api/me", { cache: "no-store" });
    await answer.json();
    took.push(performance.now() - began);
    await new Promise((done) => setTimeout(done, 100));
  }
  return took.sort((a, b) => a - b);
}"""


def test_under_load_the_page_is_quick_and_disturbs_nobody(
    spinning: Any, source_environment: dict[str, str], tmp_path: Path, until: Any
) -> None:
    """1 kHz wrench, 500 Hz joint states, 100 Hz per point, and 2,000 states a second from a stranger.

    The simulated cell and its nodes need more than three cores at these rates.
    """
    rates = {"rates.joints": 500.0, "rates.tracker": 100.0, "rates.wrench": 1000.0}
    client = spinning.plain("outside")
    ages: list[float] = []
    client.create_subscription(Permission, PERMISSION.relative, lambda _: ages.append(time.monotonic()), PERMISSION.qos)
    states: list[State] = []
    listening = client.create_subscription(State, STATE.relative, states.append, STATE.qos)
    checks: dict[str, SampleCheck] = {}
    client.create_subscription(
        SampleCheck, SAMPLE_CHECK.relative, lambda one: checks.update({one.name: one}), SAMPLE_CHECK.qos
    )
    record = client.create_client(Record, "recorder/record")
    with running(spinning, source_environment, tmp_path, speed=1.0, more={"simulated_cell": rates}) as cell:
        until(lambda: states and all(one.level < one.ABSENT for one in states[-1].nodes), timeout=LONG)
        file = tmp_path / "state.cdr"
        file.write_bytes(serialize_message(states[-1]))
        spinning.executor.create_task(client.destroy_subscription, listening)  # the page alone hears the stranger
        time.sleep(5.0)
        assert record.call(Record.Request(directory=str(tmp_path / "bag")), LONG).outcome.code == Outcome.OK
        ages.clear()
        time.sleep(10.0)
        alone = longest(ages)
        with browser() as one:
            page = cell.page(one)
            page.click("#tab_during")
            page.wait_for_timeout(3000)
            ages.clear()
            page.wait_for_timeout(10_000)
            watched = longest(ages)
            floods = [Flood(source_environment, file, FLOOD / 2) for _ in range(2)]
            try:
                for flood in floods:
                    flood.begun()
                page.wait_for_timeout(3000)
                ages.clear()
                taps, rounds = page.evaluate(INTERACTION), page.evaluate(ROUND)
                flooded = longest(ages)
                metrics = page.context.new_cdp_session(page)
                metrics.send("Performance.enable")
                found = {row["name"]: row["value"] for row in metrics.send("Performance.getMetrics")["metrics"]}
                memory = resident(cell.runner.running["panel"].pid)
            finally:
                rate = sum([flood.stop() for flood in floods])
            assert page.errors == []
        heap = found["JSHeapUsedSize"] / 1e6
        words = f"tap {taps[-1]:.0f} ms, request {rounds[-1]:.0f} ms, heap {heap:.0f} MB, process {memory:.0f} MB"
        print(f"{words}; {rate:.0f} states a second; permission at most {alone:.3f} s old without the page, ", end="")
        print(f"{watched:.3f} s with it, {flooded:.3f} s in the flood")
        gaps = {name: (int(one.gaps), int(one.missing)) for name, one in checks.items()}
    assert rate >= 0.95 * FLOOD
    assert taps[-2] <= 100.0
    assert rounds[-2] <= 100.0
    assert heap <= 150.0
    assert memory <= 250.0
    assert watched <= max(1.5 * alone, alone + 0.02)
    assert flooded <= max(1.5 * alone, alone + 0.02)
    assert set(gaps.values()) == {(0, 0)}, gaps
    bag = read_bag(tmp_path / "bag", load_cell(CELL))
    assert bag.wrench is not None
    for stream, hertz in ((bag.joints, 500.0), (bag.wrench, 1000.0), *((one, 100.0) for one in bag.points.values())):
        assert len(stream.time) > 20.0 * hertz
        assert np.diff(stream.time).max() < 1.5 * NANOSECONDS / hertz


def longest(times: list[float]) -> float:
    """The longest time between two of them, s."""
    return max(later - earlier for earlier, later in itertools.pairwise(times))
