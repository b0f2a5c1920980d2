"""Watches a measurement from the side: every event the procedure hears, and every command that it gives.

Knows no ROS.  What it keeps is for people alone: nothing that it says decides anything.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence as Many

import numpy as np

from calibration_core.measurement import messages as m
from calibration_core.measurement.sequence import Sequence
from calibration_core.timeseries import Float1D

ITEMS = {m.Kind.WARM_UP: "startup", m.Kind.REFERENCE: "reference", m.Kind.CONFIGURATION_STARTED: "configuration"}
DOING = {
    m.RunState.IDLE: "the run begins",
    m.RunState.MOVING: "moving to {place}",
    m.RunState.LOADING: "changing the load at {place}",
    m.RunState.SETTLING: "waiting for standstill at {place}",
    m.RunState.READING: "reading at {place}",
    m.RunState.UNLOADING: "releasing the load at {place}",
    m.RunState.FINISHED: "the run is over",
}


class Verdict(enum.IntEnum):
    """What became of the last reading; numbers as in `ProcedureState`."""

    NONE = 0
    KEPT = 1
    REPEATED = 2
    GIVEN_UP = 3


class Party(enum.IntEnum):
    """Who is waited for; numbers as in `ProcedureState`."""

    NOBODY = 0
    OPERATOR = 1
    GUARD = 2
    ROBOT = 3
    LOAD_DEVICE = 4
    INSTRUMENTS = 5
    NODES = 6


@dataclasses.dataclass(frozen=True)
class Reading:
    """The last reading: verdict, where it was taken, and why it is not kept."""

    verdict: Verdict = Verdict.NONE
    configuration: int = 0
    step: int = 0
    text: str = ""


class Observer:
    """What a person wants to know of a run.

    Attributes:
        item: What is under way: startup, reference, configuration, or empty.
        phase: Phase of the calibration.
        configuration: Number of the present configuration; likewise `step` and `attempt`.
        target: (6,) N and N*m, base axes, load of the present step.
        goal: (n,) rad, where the motion under way ends; None: no motion.
        reading: The last one.
        readings: How many were kept.
        question: What the operator is asked to do; empty: nothing.
        by_device: Whether a load device changes the load, not the operator.
    """

    def __init__(self, sequence: Sequence) -> None:
        """Watch a run of a procedure."""
        plan = sequence.queue.plan
        self._steps = {one.number: len(one.steps) for one in (*plan.preparation, *plan.configurations)}
        self._sequence, self.by_device = sequence, False
        self.item, self.phase = "", ""
        self.configuration = self.step = self.attempt = 0
        self.target: Float1D = np.zeros(6)
        self.unknown = False  # another run may have left the load on that is to be released
        self.goal: Float1D | None = None
        self.reading, self.readings = Reading(), 0
        self.question = ""
        self._asked_in: tuple[m.RunState, bool] = (m.RunState.IDLE, False)

    def hear(self, event: m.Event, commands: Many[m.Command]) -> None:
        """Take an event and what the procedure commands in answer to it."""
        if isinstance(event, m.ReadingConfirmed):
            self.reading = Reading(Verdict.KEPT, self.configuration, self.step)
            self.readings += 1
        elif isinstance(event, m.ReadingFailed):
            self.reading = Reading(Verdict.REPEATED, self.configuration, self.step, event.reason)
        for command in commands:
            self._note(command)
        where = (self._sequence.state, self._sequence.paused)
        if where != self._asked_in and not any(isinstance(one, m.AskOperator) for one in commands):
            self.question = ""
        self._asked_in = where
        if self._sequence.state is not m.RunState.MOVING:
            self.goal = None

    def ask(self, text: str) -> None:
        """Take what else the operator is asked, which the procedure does not know of."""
        self.question = text
        self._asked_in = (self._sequence.state, self._sequence.paused)

    def _note(self, command: m.Command) -> None:
        match command:
            case m.Mark():
                self.configuration, self.step = command.configuration, command.step
            case m.BeginAttempt():
                self.configuration, self.attempt = command.configuration, command.attempt
            case m.Move():
                self.goal, self.target = command.q, np.zeros(6)
            case m.RequestLoad():
                self.target, self.unknown = command.wrench, command.unknown
            case m.AskOperator():
                self.question = command.text
            case m.Record() if command.kind in ITEMS:
                self.item = ITEMS[command.kind]
            case m.Record() if command.kind is m.Kind.PHASE:
                self.phase = command.text
            case m.Record() if command.kind in (m.Kind.CONFIGURATION_RETRIED, m.Kind.CONFIGURATION_SKIPPED):
                self.reading = Reading(Verdict.GIVEN_UP, command.configuration, command.step, command.text)

    @property
    def steps(self) -> int:
        """Load steps of the present configuration."""
        return self._steps.get(self.configuration, 1)

    @property
    def load_awaited(self) -> bool:
        """Whether a load is to be brought on or released now."""
        return self._sequence.state in (m.RunState.LOADING, m.RunState.UNLOADING)

    @property
    def waits_for(self) -> Party:
        """Who is waited for."""
        match self._sequence.state:
            case m.RunState.READY:
                return Party.OPERATOR if self._sequence.paused else Party.GUARD
            case m.RunState.MOVING | m.RunState.SETTLING:
                return Party.ROBOT
            case m.RunState.LOADING | m.RunState.UNLOADING:
                return Party.LOAD_DEVICE if self.by_device else Party.OPERATOR
            case m.RunState.READING:
                return Party.INSTRUMENTS
        return Party.NOBODY

    @property
    def text(self) -> str:
        """What is being done, one line."""
        if self._sequence.state is m.RunState.READY:
            return f"{'paused' if self._sequence.paused else 'waiting'} before the next motion or load step"
        place = self.item if self.item in ("startup", "reference") else f"configuration {self.configuration}"
        if self.item == "configuration" and self._sequence.state is not m.RunState.MOVING:
            place += f", step {self.step + 1} of {self.steps}"
        return DOING[self._sequence.state].format(place={"startup": "the start-up cycle"}.get(place, place))

    @property
    def waiting(self) -> str:
        """What is waited for, and from whom, one line; empty: nothing."""
        match self.waits_for:
            case Party.OPERATOR if self.load_awaited:
                force = ", ".join(f"{value:.0f}" for value in self.target[:3])
                what = f"pull with ({force}) N" if np.any(self.target) else "release the load"
                what += " that another run may have left on" if self.unknown else ""
                return f"operator: {what}, then confirm"
            case Party.OPERATOR:
                return f"operator: {self.question or 'resume when it is safe to go on'}"
            case Party.GUARD:
                return "guard: permission to move"
            case Party.ROBOT:
                return f"robot: {self._sequence.state.value}"
            case Party.LOAD_DEVICE:
                return f"load device: {self._sequence.state.value}"
            case Party.INSTRUMENTS:
                return "instruments: a settled window"
        return ""
