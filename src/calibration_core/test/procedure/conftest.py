"""Cells and plans that the procedure's tests run on, and a world that the procedure can be let loose on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.measurement import messages as m
from calibration_core.measurement.messages import RunState
from calibration_core.measurement.sequence import Sequence
from calibration_core.model.chain import Chain
from calibration_core.motion.speed import Monitored
from calibration_core.planning.loaded import make_plan
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import REFERENCE_NUMBER, Plan, PlannedConfiguration, Reference

CELLS = Path(__file__).parents[4] / "config" / "cells"


@pytest.fixture(scope="session")
def demo_cell() -> Cell:
    """Return the 240 kg robot, described by a URDF."""
    return load_cell(CELLS / "demo.cell.yaml")


@pytest.fixture(scope="session")
def small_cell() -> Cell:
    """Return the 10 kg robot, described by DH rows, with a spherical tracker."""
    return load_cell(CELLS / "small.cell.yaml")


@pytest.fixture(scope="session")
def plan(demo_cell: Cell) -> Plan:
    """Return the default plan of the demo cell."""
    return make_plan(demo_cell)


@pytest.fixture(scope="session")
def plane_arm() -> Monitored:
    """Return a planar arm of two metres: the speed of its end is easy to say."""
    arm = Chain(
        joints=("a", "b", "c"),
        rotation=np.tile(np.eye(3), (3, 1, 1)),
        translation=np.array([[0.0, 0, 0], [1.0, 0, 0], [0.5, 0, 0]]),
        offset=np.zeros(3),
        flange_rotation=np.eye(3),
        flange_translation=np.array([0.5, 0, 0]),
        limits=np.tile([-3.0, 3.0], (3, 1)),
        gravity=np.zeros(3),
    )
    lever = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.5, 0.5, 0], [2.0, 1.0, 0.5]])
    return Monitored(arm, ("a", "b", "c", "flange"), np.zeros((1, 3)), lever)


LEVELS = np.array([0.0, 500.0, 1000.0, 0.0])
RULES = SequenceRules(startup_period=500.0)


def small_plan(levels: np.ndarray = LEVELS, count: int = 4, spares: int = 2, every: int = 2) -> Plan:
    """Return a plan of four configurations and two spares for three joints."""
    steps = np.outer(levels, [0.6, 0, -0.8, 0, 0, 0])
    return Plan(
        robot="robot",
        joints=("a", "b", "c"),
        configurations=tuple(
            PlannedConfiguration(i + 1, np.full(3, 0.1 * (i + 1)), steps, spare=i >= count)
            for i in range(count + spares)
        ),
        startup_cycle=np.array([[1.0, 0, 0], [0.0, 0, 0]]),
        reference=Reference(np.zeros(3), every),
    )


class World:
    """A cell that does what it is told, or not; it knows the rules and complains when one is broken."""

    def __init__(self, plan: Plan, rules: SequenceRules = RULES, **resumed: object) -> None:
        self.plan, self.rules = plan, rules
        self.everything = (*plan.preparation, *plan.configurations)
        self.sequence = Sequence(plan, rules, **resumed)  # type: ignore[arg-type]
        self.now = 0.0
        self.permitted = self.heard = self.paused = self.lost = False
        self.asked: m.Command | None = None  # the command that waits for an answer
        self.readings_asked: list[m.TakeReading] = []
        self.place: np.ndarray | None = None
        self.load_known = not resumed.get("loaded")
        self.load = np.zeros(6) if self.load_known else np.full(6, 7.0)
        self.settled = False
        self.pulls = ""  # what the sensor tells of before a motion
        self.attempt: m.BeginAttempt | None = None
        self.confirmed: dict[tuple[int, int], list[int]] = {}
        self.visits: list[int] = []
        self.completed: list[int] = []
        self.attempts: dict[int, int] = {}
        self.wishes: dict[int, int] = {}  # of the operator, to have a configuration measured again
        self.records: list[m.Record] = []
        self.marks: list[m.Mark] = []
        self.finish: m.Finish | None = None

    def wrenches(self, number: int) -> np.ndarray:
        if number == REFERENCE_NUMBER:
            return np.zeros((1000, 6))
        return next(c.steps for c in self.everything if c.number == number)

    def tell(self, event: m.Event) -> None:
        over = self.finish is not None
        moving = isinstance(self.asked, m.Move)
        commands = self.sequence.handle(event)
        if over:
            assert commands == ()
        if moving and isinstance(event, m.PermissionChanged) and not event.permitted and self.permitted:
            assert isinstance(commands[-1] if len(commands) == 1 else self._stop_in(commands), m.StopMotion)
        if isinstance(event, m.PermissionChanged):
            self.lost |= self.permitted and not event.permitted and self.sequence.state is not RunState.IDLE
            self.permitted = event.permitted
        if isinstance(event, m.GuardHearing):
            self.heard = event.hears
        for command in commands:
            self._do(command)

    @staticmethod
    def _stop_in(commands: tuple[m.Command, ...]) -> m.Command | None:
        return next((command for command in commands if isinstance(command, m.StopMotion)), None)

    def _do(self, command: m.Command) -> None:
        match command:
            case m.Mark():
                self.marks.append(command)
            case m.Record():
                self.records.append(command)
            case m.AskOperator():
                assert command.text
            case m.Finish():
                assert self.finish is None
                assert self.attempt is None, "ends with an attempt open"
                self.finish, self.asked = command, None
            case m.BeginAttempt() | m.EndAttempt():
                self._attempt(command)
            case _:
                self._act_of_the_cell(command)

    def _act_of_the_cell(self, command: m.Command) -> None:
        match command:
            case m.Move():
                assert self.permitted, "moves without permission"
                assert self.heard, "moves while the guard does not hear that it lives"
                assert not self.paused, "moves in a pause"
                assert not self.lost, "moves by itself after a loss of permission"
                assert self.load_known, "moves with a load under way"
                assert not self.load.any(), "moves with a load on"
                assert not self.pulls, "moves with a load on that the sensor tells of"
                assert not isinstance(self.asked, m.Move), "moves while moving"
                self.asked, self.place, self.settled = command, None, False
            case m.StopMotion():
                assert isinstance(self.asked, m.Move), "stops what does not move"
                self.asked = None
            case m.RequestLoad():
                if command.unknown:
                    assert not self.load_known or self.pulls
                    assert not command.wrench.any(), "loads a robot of which nothing is known"
                    assert self.attempt is None or self.pulls
                else:
                    assert self.place is not None, "loads a robot that has not arrived"
                assert not self.paused, "loads in a pause"
                assert not self.lost
                self.asked, self.load, self.load_known, self.settled = command, command.wrench, False, False
            case m.AwaitSettled():
                self.asked, self.settled = command, False
            case m.TakeReading():
                self._reading(command)

    def _attempt(self, command: m.BeginAttempt | m.EndAttempt) -> None:
        if isinstance(command, m.BeginAttempt):
            assert self.attempt is None
            assert command.attempt == self.attempts.get(command.configuration, -1) + 1
            wished = self.wishes.get(command.configuration, 0)
            assert command.attempt < self.rules.attempts + wished, "tries too often"
            self.attempts[command.configuration] = command.attempt
            self.attempt = command
            return
        assert self.attempt is not None
        assert (self.attempt.configuration, self.attempt.attempt) == (command.configuration, command.attempt)
        if command.completed:
            steps = self.confirmed[command.configuration, command.attempt]
            assert steps == list(range(len(self.wrenches(command.configuration)))), "completed with gaps"
            self.completed.append(command.configuration)
        self.attempt = None

    def _reading(self, command: m.TakeReading) -> None:
        assert self.place is not None, "reads before arrival"
        assert self.settled, "reads before standstill"
        assert self.load_known, "reads while the load changes"
        assert not self.paused, "begins a reading in a pause"
        wanted = self.wrenches(command.configuration)[command.step]
        assert np.array_equal(self.load, wanted), "reads under another load than planned"
        if command.configuration != REFERENCE_NUMBER:
            q = next(c.q for c in self.everything if c.number == command.configuration)
            assert np.array_equal(self.place, q), "reads somewhere else"
        self.asked = command
        self.readings_asked.append(command)

    # --- what the cell may answer -------------------------------------------------------------------------------------

    def answer(self) -> None:
        """Do what was asked for."""
        asked, request = self.asked, getattr(self.asked, "request", 0)
        match asked:
            case m.Move():
                self.place, self.asked = asked.q, None
                self.tell(m.Arrived(self.now, request))
            case m.RequestLoad():
                self.load_known, self.asked, self.pulls = True, None, ""
                self.tell(m.LoadReached(self.now, request))
            case m.AwaitSettled():
                self.settled, self.asked = True, None
                self.tell(m.Settled(self.now, request))
            case m.TakeReading():
                self.asked = None
                self.confirm(asked)

    def confirm(self, asked: m.TakeReading) -> None:
        """Put a reading on the disk and say so."""
        self.readings_asked = [r for r in self.readings_asked if r.step != asked.step or r.attempt != asked.attempt]
        if asked.configuration == REFERENCE_NUMBER:
            self.visits.append(asked.step)
        else:
            self.confirmed.setdefault((asked.configuration, asked.attempt), []).append(asked.step)
        self.tell(m.ReadingConfirmed(self.now, asked.request))

    def fail(self) -> None:
        asked, request = self.asked, getattr(self.asked, "request", 0)
        match asked:
            case m.Move():
                self.asked = None
                self.tell(m.Blocked(self.now, request, "an obstacle"))
            case m.RequestLoad():
                self.asked = None
                self.tell(m.LoadFailed(self.now, request, "no air"))
            case m.AwaitSettled() | m.TakeReading():
                self.asked = None
                self.readings_asked = [r for r in self.readings_asked if r is not asked]
                self.tell(m.ReadingFailed(self.now, request, "beam broken"))

    def late(self) -> None:
        """Confirm a reading that was given up waiting for, while the same step is still to be read."""
        if self.attempt is None or isinstance(self.asked, m.TakeReading) or not self.readings_asked:
            return
        old = self.readings_asked[-1]
        same = (old.configuration, old.attempt) == (self.attempt.configuration, self.attempt.attempt)
        if same and isinstance(self.asked, m.AwaitSettled) and self.asked.step == old.step:
            self.asked = None
            self.confirm(old)

    def stale(self) -> None:
        """Answer requests that nobody asked any more."""
        for event in (m.Arrived, m.LoadReached, m.Settled):
            self.tell(event(self.now, -1))
        for failure in (m.Blocked, m.LoadFailed, m.ReadingFailed):
            self.tell(failure(self.now, -1, "out of date"))

    def act(self, action: str) -> None:
        """Let one thing happen, by name."""
        self.now += 200.0 if action == "wait" else 1.0
        if action in {"answer", "fail", "late", "stale"}:
            getattr(self, action)()
            return
        if action == "pulls":
            if self.sequence.about_to_move:
                self.pulls = "900 N pull"
                self.tell(m.LoadSensed(self.now, self.pulls))
            return
        if action == "pause":
            self.paused = self.sequence.state is not RunState.IDLE
        elif action == "resume" and not self.lost:
            self.paused = False
        elif action == "resume_motion":
            self.paused = self.lost = False
        elif action.startswith("repeat") and self.attempt is not None:
            self.wishes[self.attempt.configuration] = self.wishes.get(self.attempt.configuration, 0) + 1
        events = {
            "gain": m.PermissionChanged(self.now, True),
            "loss": m.PermissionChanged(self.now, False, "mode"),
            "heard": m.GuardHearing(self.now, True),
            "unheard": m.GuardHearing(self.now, False),
            "pause": m.Pause(self.now),
            "resume": m.Resume(self.now),
            "resume_motion": m.ResumeMotion(self.now, "A. Smith"),
            "repeat": m.Redo(self.now),
            "skip": m.Redo(self.now, skip=True),
            "repeat_after_load": m.Redo(self.now, moves_load=True),
            "skip_after_load": m.Redo(self.now, skip=True, moves_load=True),
            "tick": m.Tick(self.now),
            "wait": m.Tick(self.now),
            "stop": m.Stop(self.now),
            "fault": m.Fault(self.now, "cable torn"),
        }
        self.tell(events[action])

    def run(self, limit: int = 2000) -> m.Finish:
        """Let everything go well until the end."""
        for action in ("resume_motion", "gain", "heard", "resume_motion"):
            self.act(action)
        for _ in range(limit):
            if self.finish is not None:
                return self.finish
            self.act("answer" if self.asked is not None else "tick")
        pytest.fail(f"no end after {limit} events, waiting for {self.sequence.state}")


@pytest.fixture(scope="session")
def plan_of() -> Callable[..., Plan]:
    """Return the maker of small plans."""
    return small_plan


@pytest.fixture(scope="session")
def new_world() -> type[World]:
    """Return the class of worlds."""
    return World


@pytest.fixture(scope="session")
def started() -> Callable[..., World]:
    """Return the maker of worlds in which the procedure has been started."""

    def make(plan: Plan | None = None, **changes: object) -> World:
        world = World(plan or small_plan(), **changes)  # type: ignore[arg-type]
        world.tell(m.Start(0.0))
        world.tell(m.GuardHearing(0.0, hears=True))
        return world

    return make
