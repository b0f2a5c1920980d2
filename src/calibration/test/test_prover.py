"""One proof of the stop after another: what is left of one that failed is not taken for the next one's."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import ProveStop

from calibration.conversions import to_outcome
from calibration.motion.base import End
from calibration.motion.prover import REST, SERVICE, Prover

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))


class Driver:
    """A back end whose goals end when the test says so."""

    answers = commands = True

    def __init__(self) -> None:
        self.goal: bytes | None = None
        self.goals: list[Any] = []  # who is told of the end of each
        self.stops = 0

    def move(self, _trajectory: Any, done: Any) -> None:
        self.goals.append(done)
        self.goal = None  # not accepted yet

    def stop(self) -> None:
        self.stops += 1


def test_the_end_of_an_earlier_goal_is_not_that_of_the_next_one(spinning: Any, until: Any) -> None:
    guard, verdicts = spinning.plain("guard"), [Outcome.TEST_FAILED, Outcome.OK]

    def judge(_request: Any, response: Any) -> Any:
        response.outcome = to_outcome(verdicts.pop(0), "a joint moved")
        return response

    guard.create_service(ProveStop, SERVICE, judge)
    driver = Driver()
    prover = Prover(spinning.plain("prover"), driver, JOINTS, lambda: np.zeros(6))
    assert prover._client is not None
    assert prover._client.wait_for_service(20.0)

    def tried() -> bool:
        prover.tick(time.monotonic())
        return not prover.running

    prover.begin(time.monotonic(), 1.0)
    driver.goal = bytes(16)
    until(tried)
    assert (prover.proven, driver.stops) == (False, 1)
    assert not prover.rested(time.monotonic()), "its goal is being cancelled"
    time.sleep(REST)
    assert not prover.rested(time.monotonic()), "its goal has not ended"
    first = driver.goals[0]
    first(End.FAILURE, "cancelled")
    assert prover.rested(time.monotonic())
    prover.begin(time.monotonic(), 1.0)
    first(End.FAILURE, "cancelled")  # late, and once more
    prover.tick(time.monotonic())
    assert prover.running
    driver.goal = bytes(16)
    until(tried)
    assert prover.proven
