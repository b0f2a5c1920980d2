"""The thread that carries out the procedure, in a cell of stand-ins: drivers that lie, instruments that fail."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from calibration_interfaces.msg import Permission

from calibration import runner as module
from calibration.clients import Measured
from calibration.motion.arrival import ArrivalRules, Joints
from calibration.motion.base import End
from calibration.permission import PermissionWatch
from calibration.readings import ReadingError
from calibration.runner import Call, Runner
from calibration_core.cell import load_cell
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.procedure import messages as m
from calibration_core.procedure.agenda import SequenceRules
from calibration_core.procedure.plan import Plan, PlannedConfiguration
from calibration_core.procedure.sequence import Sequence
from calibration_core.procedure.speed import Monitored
from calibration_core.procedure.trajectory import MotionLimits

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"
HOME = np.array([0.0, 0.1, 0.1, 0.0, 0.3, 0.0])
FAST = 50.0  # times the speed that trajectories ask for


class Robot:
    """Follows trajectories in no time, publishes joint states, and is a back end as well."""

    def __init__(self, joints: Joints) -> None:
        self.joints, self.q, self.path = joints, HOME.copy(), None
        self.commands = self.answers = True
        self.pace = FAST
        self.end_by, self.arrives, self.fails_at_once = End.SUCCESS, True, False
        self.moves: list[Any] = []
        self.stops = 0
        self._lock = threading.Lock()
        self._running = True
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def _live(self) -> None:
        while self._running:
            with self._lock:
                path = self.path
                if path is not None:
                    trajectory, begun, done = path
                    elapsed = self.pace * (time.monotonic() - begun)
                    self.q = trajectory.at(np.array([elapsed]))[0][0]
                    if elapsed >= trajectory.duration:
                        if not self.arrives:
                            self.q = self.q + 0.1
                        self.path = None
                        done(self.end_by, "so it ended")
            self.joints.add(time.monotonic_ns(), self.q.copy())
            time.sleep(0.002)

    def move(self, trajectory: Any, done: Callable[[End, str], None]) -> None:
        self.moves.append(trajectory)
        with self._lock:
            if self.fails_at_once:
                done(End.FAILURE, "no")
            else:
                self.path = (trajectory, time.monotonic(), done)

    def stop(self) -> None:
        with self._lock:
            self.stops += 1
            self.path = None

    def tick(self, now: float) -> None:
        pass

    def end(self) -> None:
        self._running = False
        self._thread.join()


class Proven:
    """A guard that has been seen to stop the robot; the proof has tests of its own, with real processes."""

    proven, running, fault = True, False, ""

    def reset(self) -> None:
        pass


class Cell:
    """Loads at once, averages at once, remembers what it was told."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.told: list[Any] = []
        self.confirmed: list[m.TakeReading] = []
        self.absent = ""
        self.rungs: list[int] = []
        self.load_works, self.fault, self.refuses = True, "", False
        self.progressed = 0
        self.leap = 0.0

    def seconds(self) -> float:
        return time.monotonic() + self.leap

    def measure(self, answered: Callable[[Measured], None]) -> None:
        end = time.monotonic_ns() + 20_000_000  # joint states of the same time are still to come
        points = (SimpleNamespace(end=end),)
        answered(Measured(fault=self.fault) if self.fault else Measured(points=points))  # type: ignore[arg-type]

    def apply_load(self, command: m.RequestLoad, answered: Callable[[bool, str], None]) -> None:
        answered(self.load_works or not np.any(command.wrench), "stuck")

    def lost(self, now: float) -> str:  # noqa: ARG002
        return self.absent

    def ready(self, since: float) -> bool:  # noqa: ARG002
        return not self.absent

    recorded = ready

    def confirm(self, command: m.TakeReading, measured: Measured) -> None:
        assert measured.points[0].end <= self.robot.joints.until
        if self.refuses:
            raise ReadingError("no joint states")
        self.confirmed.append(command)

    def carry_out(self, command: m.Command) -> None:
        self.told.append(command)

    def stop_rung(self, rung: int) -> None:
        self.rungs.append(rung)
        if rung == 0:
            self.robot.stop()

    def scaling(self) -> float:
        return float("nan")

    def look(self, now: float) -> None:
        pass

    def progress(self) -> None:
        self.progressed += 1

    def kinds(self) -> list[m.Kind]:
        return [command.kind for command in self.told if isinstance(command, m.Record)]


class Bench:
    """A runner, and everything around it."""

    def __init__(self, joints: Joints) -> None:
        self.robot = Robot(joints)
        self.cell = Cell(self.robot)
        self.watch = PermissionWatch(0.5)
        self.permitted, self.text = True, "yes"
        self.told_by_guard = self.hears = True
        cell = load_cell(CELL)
        self.monitored = Monitored.of(chain_of(cell), nominal_parameters(cell))
        steps = np.array([[0.0] * 6, [0.0, 0.0, -500.0, 0.0, 0.0, 0.0]])
        goals = HOME + np.array([[0.1], [0.2]]) * np.array([1.0, 0.5, -0.5, 1.0, 0.2, 1.0])
        spare = PlannedConfiguration(3, HOME - 0.05, steps, spare=True)
        configurations = (*(PlannedConfiguration(i + 1, q, steps) for i, q in enumerate(goals)), spare)
        self.plan = Plan(cell.robot.name, cell.robot.joints, configurations, np.empty((0, 6)))
        self.runner: Runner | None = None
        self._guard = threading.Thread(target=self._pulse, daemon=True)
        self._guarding = True
        self._guard.start()

    def _pulse(self) -> None:
        while self._guarding:
            if self.told_by_guard:
                message = Permission(
                    permitted=self.permitted,
                    text=self.text,
                    hears_sequencer=self.hears,
                    reasons=[] if self.permitted else [Permission.DRIVES_OFF],
                )
                self.watch.hear(message, time.monotonic())
            time.sleep(0.01)

    def start(self) -> tuple[Runner, threading.Thread]:
        sequence = Sequence(self.plan, SequenceRules(attempts=2, readings=2))
        limits = MotionLimits()
        self.runner = Runner(
            sequence, self.cell, self.robot, self.robot.joints, self.watch, self.monitored, limits, Proven(),
            settle_time=0.05, rungs=4,
        )  # fmt: skip
        thread = threading.Thread(target=self.runner.run, daemon=True)
        thread.start()
        return self.runner, thread

    def run(self, seconds: float = 30.0) -> m.Finish:
        runner, thread = self.start()
        thread.join(seconds)
        assert runner.finish is not None, runner.sequence.state
        return runner.finish

    def end(self) -> None:
        if self.runner is not None and self.runner.finish is None:
            self.runner.post(m.Stop(0.0))
            time.sleep(0.2)
        self._guarding = False
        self._guard.join()
        self.robot.end()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    for name, value in (("LATE", 0.3), ("CALM", 1.0), ("SLACK_TIME", 0.5)):
        monkeypatch.setattr(module, name, value)
    one = Bench(Joints(ArrivalRules(dwell=0.05)))
    yield one
    one.end()


def test_a_plan_is_measured(bench: Bench) -> None:
    finish = bench.run()
    assert finish.outcome is m.Outcome.COMPLETED
    assert [(c.configuration, c.step) for c in bench.cell.confirmed] == [(1, 0), (1, 1), (2, 0), (2, 1)]
    assert all(move.speed_bound <= 0.25 for move in bench.robot.moves)
    np.testing.assert_allclose(bench.robot.moves[0].position[0], HOME, atol=1e-9)
    assert bench.cell.progressed > 0
    assert bench.cell.rungs == []


def test_success_without_arrival_is_none(bench: Bench) -> None:
    bench.robot.arrives = False
    finish = bench.run()
    assert finish.outcome is m.Outcome.INCOMPLETE
    assert bench.cell.confirmed == []
    assert any("rad off" in c.text for c in bench.cell.told if isinstance(c, m.Record))
    assert m.Kind.SPARE_USED in bench.cell.kinds()


def test_a_clock_that_leaps_makes_no_motion_late(bench: Bench, until: Any) -> None:
    """Also a simulation's, which outruns what joint states take to arrive."""
    runner, thread = bench.start()
    for count in (1, 2):
        until(lambda count=count: len(bench.robot.moves) == count)
        bench.cell.leap += 60.0
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED
    assert m.Kind.CONFIGURATION_RETRIED not in bench.cell.kinds()


def test_nothing_moves_before_the_guard_hears_the_sequencer(bench: Bench, until: Any) -> None:
    bench.hears = False
    runner, thread = bench.start()
    until(lambda: m.Kind.OPERATOR_ASKED in bench.cell.kinds())
    time.sleep(0.3)
    assert bench.robot.moves == []
    bench.hears = True
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED


def test_a_driver_that_refuses(bench: Bench) -> None:
    bench.robot.fails_at_once = True
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert len(bench.robot.moves) == 6  # two attempts for two configurations and a spare


def test_a_motion_that_somebody_else_cancelled_waits_for_the_operator(bench: Bench, until: Any) -> None:
    bench.robot.end_by = End.CANCELLED
    runner, thread = bench.start()
    until(lambda: m.Kind.PAUSED in bench.cell.kinds())
    time.sleep(0.3)
    assert len(bench.robot.moves) == 1
    assert runner.sequence.paused
    bench.robot.end_by = End.SUCCESS
    runner.post(m.ResumeMotion(0.0, "A. Smith"))
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED


def test_a_driver_that_never_ends_is_stopped(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SLACK", 0.0)
    monkeypatch.setattr(bench.robot, "move", lambda trajectory, _: bench.robot.moves.append(trajectory))
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert bench.robot.stops >= 6
    assert any("too long" in c.text for c in bench.cell.told if isinstance(c, m.Record))


def test_a_back_end_without_answers_arrives_by_its_joint_states(bench: Bench) -> None:
    bench.robot.answers = False
    assert bench.run().outcome is m.Outcome.COMPLETED


def test_a_loss_of_permission_stops_and_waits_for_the_operator(bench: Bench, until: Any) -> None:
    runner, thread = bench.start()
    until(lambda: runner.moving)
    bench.permitted, bench.text = False, "drives off"
    until(lambda: bench.robot.stops > 0)
    bench.permitted = True
    time.sleep(0.3)
    moves = len(bench.robot.moves)
    assert runner.sequence.paused
    time.sleep(0.3)
    assert len(bench.robot.moves) == moves  # nothing moves by itself
    runner.post(m.ResumeMotion(0.0, "A. Smith"))
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED
    assert {m.Kind.PERMISSION_LOST, m.Kind.PERMISSION_GAINED, m.Kind.CONTINUED} <= set(bench.cell.kinds())


def test_a_silent_guard_is_no(bench: Bench, until: Any) -> None:
    bench.robot.pace = 1.0
    runner, _ = bench.start()
    until(lambda: runner.moving)
    bench.told_by_guard = False
    until(lambda: bench.robot.stops > 0)
    assert "the guard is silent" in [c.text for c in bench.cell.told if isinstance(c, m.Record)]


def test_the_ladder_is_climbed_when_the_robot_goes_on(
    bench: Bench, until: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.robot.pace = 1.0
    runner, _ = bench.start()
    until(lambda: runner.moving)
    monkeypatch.setattr(bench.robot, "stop", lambda: None)  # deaf
    monkeypatch.setattr(bench.robot.joints, "standing", lambda: False)
    bench.permitted = False
    until(lambda: bench.cell.rungs[-1:] == [3])
    assert bench.cell.rungs[0] == 0
    assert sorted(set(bench.cell.rungs)) == [0, 1, 2, 3]


def test_a_recorder_that_falls_silent_pauses_until_it_is_back(bench: Bench, until: Any) -> None:
    runner, thread = bench.start()
    until(lambda: runner.moving)
    bench.cell.absent = "the recorder is silent"
    until(lambda: m.Kind.PAUSED in bench.cell.kinds())
    moves = len(bench.robot.moves)
    runner.post(m.Resume(0.0))  # too early
    time.sleep(0.3)
    bench.cell.absent = ""
    assert (runner.sequence.paused, len(bench.robot.moves)) == (True, moves)  # nothing moves by itself
    runner.post(m.Resume(0.0))
    thread.join(30.0)
    assert runner.finish is not None and runner.finish.outcome is m.Outcome.COMPLETED  # noqa: PT018


def test_instruments_that_fail(bench: Bench) -> None:
    bench.cell.fault = "tracker: beam broken"
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert any("beam broken" in c.reason for c in bench.cell.told if isinstance(c, m.EndAttempt))


def test_readings_that_cannot_be_stored(bench: Bench) -> None:
    bench.cell.refuses = True
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert any("no joint states" in c.reason for c in bench.cell.told if isinstance(c, m.EndAttempt))


def test_a_load_device_that_is_stuck(bench: Bench) -> None:
    bench.cell.load_works = False
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert {c.step for c in bench.cell.confirmed} == {0}


def test_pause_and_stop(bench: Bench, until: Any) -> None:
    runner, thread = bench.start()
    until(lambda: runner.moving)
    runner.post(m.Pause(0.0))
    until(lambda: bench.robot.stops > 0)
    until(lambda: not runner.moving)
    done: list[int] = []
    runner.post(Call(lambda: done.append(threading.get_ident())))
    until(lambda: done)
    assert done == [thread.ident]
    runner.post(m.Stop(0.0))
    thread.join(5.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.STOPPED


def test_a_robot_without_joint_states_is_not_moved(bench: Bench) -> None:
    bench.robot.end()
    bench.robot.joints._samples.clear()
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert bench.robot.moves == []
