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
from calibration.motion.backends import End
from calibration.motion.prover import FASTEST, REST, SERVICE, Prover
from calibration.node import CalibrationNode

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))


class Driver:
    """A back end whose goals end when the test says so."""

    answers = commands = True

    def __init__(self) -> None:
        self.goal: bytes | None = None
        self.goals: list[Any] = []  # who is told of the end of each
        self.seconds: list[float] = []  # how long each lasts by the robot's clock
        self.stops = 0

    def move(self, trajectory: Any, done: Any) -> None:
        self.goals.append(done)
        self.seconds.append(float(trajectory.time[-1]))
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
    prover = Prover(
        spinning.add(CalibrationNode("prover", (), context=spinning.context)),
        driver,
        JOINTS,
        lambda: (np.zeros(6), np.zeros(6), 0.0),
    )
    assert prover._guard is not None
    until(prover._guard.ready)

    def tried() -> bool:
        prover.tick(time.monotonic())
        return not prover.running

    prover.begin(time.monotonic())
    driver.goal = bytes(16)
    until(tried)
    assert (prover.proven, driver.stops) == (False, 1)
    assert not prover.rested(time.monotonic()), "its goal is being cancelled"
    time.sleep(REST)
    assert not prover.rested(time.monotonic()), "its goal has not ended"
    first = driver.goals[0]
    first(End.FAILURE, "cancelled")
    until(lambda: prover.rested(time.monotonic()))
    prover.begin(time.monotonic())
    first(End.FAILURE, "cancelled")  # late, and once more
    prover.tick(time.monotonic())
    assert prover.running
    driver.goal = bytes(16)
    until(tried)
    assert prover.proven


def test_a_clock_that_stood_still_at_first_does_not_shorten_every_goal(
    spinning: Any, until: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The computer of a simulated robot is busy when a run begins: the next proof knows how fast the clock goes."""
    guard = spinning.plain("guard")
    node = spinning.add(CalibrationNode("prover", (), context=spinning.context))

    def judge(_request: Any, response: Any) -> Any:
        response.outcome = to_outcome(Outcome.TEST_FAILED, "the goal ended before it was cancelled")
        return response

    guard.create_service(ProveStop, SERVICE, judge)
    driver, clock = Driver(), [0.0, 1.0]  # s of the robot's clock, and its pace
    prover = Prover(node, driver, JOINTS, lambda: (np.zeros(6), np.zeros(6), 0.0))
    assert prover._guard is not None
    until(prover._guard.ready)
    monkeypatch.setattr(node, "now_ns", lambda: round(1e9 * clock[0]))
    now = time.monotonic()

    def later(seconds: float) -> float:
        nonlocal now
        now, clock[0] = now + seconds, clock[0] + clock[1] * seconds
        return now

    prover.reset()
    assert not prover.rested(later(0.0)), "nobody knows yet how fast the clock goes"
    assert not prover.rested(later(0.1))
    assert prover.rested(later(0.15))
    prover.begin(now)
    clock[1] = 20.0
    driver.goal = bytes(16)
    until(lambda: prover.tick(later(1e-3)) or not prover.running)
    driver.goals[0](End.SUCCESS, "")
    monkeypatch.setattr(prover, "_ended", now)
    while not prover.rested(later(0.1)):
        assert len(driver.goals) == 1
    prover.begin(now)
    assert driver.seconds[0] == 2.0
    assert driver.seconds[1] > 0.9 * 20.0 * 2.0
    clock[1] = 1e6
    prover.running = False
    assert prover.rested(later(6.0))
    prover.begin(now)
    assert driver.seconds[2] == 2.0 * FASTEST, "a clock that leaps"
