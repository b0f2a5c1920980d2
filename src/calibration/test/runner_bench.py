"""A cell of stand-ins around the thread that carries out the procedure: drivers that lie, instruments that fail."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from calibration_interfaces.msg import Permission

from calibration.cell.clients import Measured
from calibration.cell.reading_checks import ReadingError
from calibration.cell.watches import PermissionWatch
from calibration.motion.arrival import Joints
from calibration.motion.backends import End
from calibration.motion.stop import Stopper
from calibration.sequencer.goal import Goal
from calibration.sequencer.runner import Runner
from calibration_core.cell import load_cell
from calibration_core.measurement import messages as m
from calibration_core.measurement.sequence import Sequence
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration

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
        self.lag = 0.0  # s, joint states come late
        self.leap = 0.0  # s, by which the clock that stamps them was set
        self.moves: list[Any] = []
        self.stops = 0
        self._lock = threading.Lock()
        self._running = True
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def _live(self) -> None:
        late: deque[tuple[float, int, Any]] = deque()
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
            late.append((time.monotonic(), time.monotonic_ns() + round(self.leap * 1e9), self.q.copy()))
            while late and time.monotonic() - late[0][0] >= self.lag:
                self.joints.add(*late.popleft()[1:])
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


class Staged(Stopper):
    """The stages of the stop, of which the first alone reaches the robot."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.stages: list[int] = []

    def take(self, stage: int) -> None:
        self.stages.append(stage)
        if stage == 0:
            super().take(stage)


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
        self.pull: str | None = ""
        self.load_works, self.fault, self.refuses = True, "", False
        self.progressed = 0

    @property
    def leap(self) -> float:
        """By how much the clock of the cell was set, s."""
        return self.robot.leap

    @leap.setter
    def leap(self, seconds: float) -> None:
        self.robot.leap = seconds

    def seconds(self) -> float:
        return time.monotonic() + self.leap

    def measure(self, _configuration: int, answered: Callable[[Measured], None]) -> None:
        end = time.monotonic_ns() + 20_000_000  # joint states of the same time are still to come
        points = (SimpleNamespace(end=end),)
        answered(Measured(fault=self.fault) if self.fault else Measured(points=points))  # type: ignore[arg-type]

    def exclude(self, command: m.TakeReading, excluded: dict[str, str]) -> None:
        pass

    def apply_load(self, command: m.RequestLoad, answered: Callable[[bool, str], None]) -> None:
        if command.unknown:
            self.pull = ""
        answered(self.load_works or not np.any(command.wrench), "stuck")

    def pulls(self) -> str | None:
        return self.pull

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
        self.monitored = Monitored.of(chain_of(cell), nominal_parameters(cell), None)
        steps = np.array([[0.0] * 6, [0.0, 0.0, -500.0, 0.0, 0.0, 0.0]])
        goals = HOME + np.array([[0.1], [0.2]]) * np.array([1.0, 0.5, -0.5, 1.0, 0.2, 1.0])
        spare = PlannedConfiguration(3, HOME - 0.05, steps, spare=True)
        configurations = (*(PlannedConfiguration(i + 1, q, steps) for i, q in enumerate(goals)), spare)
        self.plan = Plan(cell.robot.name, cell.robot.joints, configurations, np.empty((0, 6)))
        self.runner: Runner | None = None
        self.stopper = Staged(SimpleNamespace(), self.robot, cell.robot.joints, lambda: None)
        self._guard = threading.Thread(target=self._pulse, daemon=True)
        self._guarding, self._saying = True, threading.Lock()
        self._guard.start()

    def say_not_heard(self) -> None:
        """Let the guard say, from now on, that it does not hear the sequencer; no message of before arrives later."""
        with self._saying:
            self.hears = False
            self._say()

    def say(self, *, permitted: bool) -> None:
        """Let the guard say so, now and from now on."""
        with self._saying:
            self.permitted = permitted
            self._say()

    def _say(self) -> None:
        message = Permission(
            permitted=self.permitted,
            text=self.text,
            hears_sequencer=self.hears,
            reasons=[] if self.permitted else [Permission.DRIVES_OFF],
        )
        self.watch.hear(message, time.monotonic())

    def _pulse(self) -> None:
        while self._guarding:
            if self.told_by_guard:
                with self._saying:
                    self._say()
            time.sleep(0.01)

    def start(self) -> tuple[Runner, threading.Thread]:
        sequence = Sequence(self.plan, SequenceRules(attempts=2, readings=2))
        limits = MotionLimits()
        self.goal = Goal(None, self.robot.stop)
        self.runner = Runner(
            self.goal, sequence, self.cell, self.robot, self.robot.joints, self.watch, self.monitored, limits, Proven(),
            self.stopper, settle_time=0.05,
        )  # fmt: skip
        self.goal.begin(self.runner)
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
