"""What tests put in place of drivers and clients of the instruments' nodes."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces.action import Measure
from goals import GoalClient
from rclpy.parameter import Parameter

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"
IRREGULAR = 1e4  # for `gap`: what a busy machine publishes irregularly has none, in tests of something else


def overrides(**values: Any) -> list[Parameter]:
    given = {"cell": str(CELL), "window": 0.2, "timeout": 15.0, "min_samples": 10, **values}
    return [Parameter(name, value=value) for name, value in given.items()]


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
