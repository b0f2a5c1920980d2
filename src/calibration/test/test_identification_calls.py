"""Many calls at once: every one is answered, and soon, whatever is being computed."""

from __future__ import annotations

import collections
import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from granted import Granted

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import IdentifyStiffness
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile

ROOT = Path(__file__).resolve().parents[3]
CELL = ROOT / "config" / "cells" / "small.cell.yaml"
BAG = ROOT / "bags" / "small_loaded"
EXECUTABLE = ROOT / "install" / "calibration" / "lib" / "calibration" / "identification"
CALLS = 200
SOON = 2.0  # s
TRIALS = 3
LONG = 60.0


@pytest.mark.parametrize(("clients", "depth"), [(1, CALLS), (20, 10)])
def test_every_call_is_answered(
    clients: int, depth: int, spinning: Any, until: Any, source_environment: dict[str, str], tmp_path: Path
) -> None:
    """One is worked on; the others hear at once that it is.

    A client's own queue holds ten requests and answers by default: one that asks more at once has to have a longer one.
    A computer that stands still for a moment, for its disk or its host, delays everybody: what was late is asked again.
    """
    process = subprocess.Popen([str(EXECUTABLE), "--ros-args", "-p", f"cell:={CELL}"], env=source_environment)
    try:
        node = spinning.plain()
        name, queue = "identification/identify_stiffness", QoSProfile(depth=depth)
        asking = [node.create_client(IdentifyStiffness, name, qos_profile=queue) for _ in range(clients)]
        assert all(client.wait_for_service(LONG) for client in asking)
        other = node.create_client(GetParameters, "identification/get_parameters")
        assert other.wait_for_service(LONG)
        time.sleep(2.0)  # until the node has found the clients, too: it answers nobody whom it does not know
        for trial in range(TRIALS):
            out = tmp_path / f"out{trial}"
            request = IdentifyStiffness.Request(recording=str(BAG), cell=str(CELL), out=str(out))
            busy, slowest = ask(asking, other, request, until, process.pid)
            print(f"{clients} clients: BUSY within {busy:.2f} s, another service within {slowest:.2f} s")
            assert json.loads((out / "result.json").read_text())["command"] == "identify"
            if max(busy, slowest) < SOON:
                break
        assert max(busy, slowest) < SOON
    finally:
        process.terminate()
        assert process.wait(LONG) == 0


def ask(asking: list[Any], other: Any, request: Any, until: Any, server: int) -> tuple[float, float]:
    """Ask for everything at once, and another service meanwhile; return when the last was refused, and its slowest."""
    answered: dict[int, float] = {}
    began, watch = time.monotonic(), Granted(os.getpid(), server)
    futures = [asking[number % len(asking)].call_async(request) for number in range(CALLS)]
    for number, future in enumerate(futures):
        future.add_done_callback(lambda _, number=number: answered.setdefault(number, time.monotonic() - began))
    slowest, waits = 0.0, list[tuple[float, float]]()  # s since the begin, s of them not granted
    while len(answered) < CALLS and time.monotonic() - began < LONG:
        asked = Granted(os.getpid(), server)
        one = other.call_async(GetParameters.Request(names=["cell"]))
        until(one.done, timeout=LONG)
        slowest = max(slowest, asked.seconds)
        waits.append((time.monotonic() - began, watch.waited))
        time.sleep(0.1)
    assert len(answered) == CALLS, f"{len(answered)} of {CALLS}"
    codes = collections.Counter(future.result().outcome.code for future in futures)
    assert set(codes) == {Outcome.OK, Outcome.BUSY}, codes
    late = [answered[i] for i, future in enumerate(futures) if future.result().outcome.code == Outcome.BUSY]
    return max(late) - next((waited for at, waited in waits if at > max(late)), watch.waited), slowest
