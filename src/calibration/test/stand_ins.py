"""What tests put in place of drivers and clients of the instruments' nodes."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from calibration_interfaces.action import Measure
from goals import GoalClient
from rclpy.parameter import Parameter

from calibration_core.cell import load_cell
from calibration_core.measurement.unloaded import LoadMemory, ProvenZero, memory_file
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import Load
from calibration_core.timeseries import Float1D

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"
IRREGULAR = 1e4  # for `gap`: what a busy machine publishes irregularly has none, in tests of something else


def overrides(**values: Any) -> list[Parameter]:
    given = {"cell": str(CELL), "window": 0.2, "timeout": 15.0, "min_samples": 10, **values}
    return [Parameter(name, value=value) for name, value in given.items()]


def unloaded(home: Path, cell: Path = CELL, namespace: str = "/") -> Path:
    """Leave a cell behind in which nothing pulls, and whose sensor says so in every posture; return what is kept."""
    described = load_cell(cell)
    memory = LoadMemory(memory_file(described, namespace, home=home))
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (8, len(described.robot.joints))):
        memory.proven(ProvenZero(0, q, np.zeros(6), "the test"))
    return memory.path


class Bent:
    """Where a tracker sees the targets of a robot that gives way as its cell file says."""

    def __init__(self, file: Path = CELL) -> None:
        cell = load_cell(file)
        self._chain, self._nominal = chain_of(cell), nominal_parameters(cell)

    def seen(self, q: Sequence[float], force: Sequence[float]) -> dict[str, Float1D]:
        """Return (3,) m by name, in a tracker's frame that is the robot's, under a force (3,) N at the wrench point."""
        nominal = self._nominal
        assert nominal.wrench_point is not None
        load = Load(np.array(force, float)[:, None], np.zeros((3, 1)), nominal.wrench_point, None)
        at = solve_equilibrium(self._chain, np.array(q, float)[None], nominal.compliance, load).at
        return {name: at.point(point)[:, 0] for name, point in nominal.points.items()}


@dataclasses.dataclass
class Feed:
    """Publishes a message made anew every few milliseconds until told to stop."""

    publisher: Any
    make: Callable[[int], Any]
    period: float = 0.005
    sent: int = 0

    def __post_init__(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(self.period):
            self.publisher.publish(self.make(self.sent))
            self.sent += 1

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(2.0)


def call(client: Any, request: Any, timeout: float = 40.0) -> Any:
    assert client.wait_for_service(timeout)
    future = client.call_async(request)
    end = time.monotonic() + timeout
    while not future.done():
        assert time.monotonic() < end, "no answer"
        time.sleep(0.005)
    return future.result()


def finish(future: Any, timeout: float = 40.0) -> Any:
    end = time.monotonic() + timeout
    while not future.done():
        assert time.monotonic() < end, "no answer"
        time.sleep(0.005)
    return future.result()


def measure(node: Any, name: str, goal: Any) -> Any:
    client = GoalClient(node, Measure, name)
    assert client.wait_for_server(15.0)
    handle = finish(client.send_goal_async(goal))
    assert handle.accepted
    return finish(handle.get_result_async()).result
