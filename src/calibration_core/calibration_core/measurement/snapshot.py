"""How a measurement stands, for people: one value, taken from the procedure; nothing that it says decides anything."""

from __future__ import annotations

import dataclasses
import enum

from calibration_core.measurement.messages import RunState
from calibration_core.timeseries import Phase

DOING = {
    RunState.IDLE: "the run begins",
    RunState.MOVING: "moving to {place}",
    RunState.LOADING: "changing the load at {place}",
    RunState.SETTLING: "waiting for standstill at {place}",
    RunState.READING: "reading at {place}",
    RunState.UNLOADING: "releasing the load at {place}",
    RunState.FINISHED: "the run is over",
}
UNLOADED = (0.0,) * 6


class ReadingVerdict(enum.IntEnum):
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
class LastReading:
    """The last reading: verdict, where it was taken, and why it is not kept."""

    verdict: ReadingVerdict = ReadingVerdict.NONE
    configuration: int = 0
    step: int = 0
    text: str = ""


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """A procedure at one moment.

    Attributes:
        state: What it waits for.
        paused: Whether nothing new begins before the operator resumes.
        held: Whether motion has to be resumed by name.
        item: What is under way: startup, reference, configuration, or empty.
        phase_name: Phase of the calibration, in a plan that has several.
        configuration: Number of the present configuration, as announced last; likewise `step` and `phase`.
        attempt: Of the present configuration, 0 first.
        steps: Load steps of the present configuration.
        target: (6,) N and N*m, base axes, load of the present step.
        unknown: Whether another run may have left the load on that is to be released.
        goal: (n,) rad, where the motion under way ends; empty: no motion.
        reading: The last one.
        readings: How many were kept.
        question: What the operator is asked to do; empty: nothing.
        by_device: Whether a load device changes the load, not the operator.
        done: Configurations that are measured; likewise `given_up`, and `total`, that are wanted.
    """

    state: RunState
    paused: bool
    held: bool
    item: str
    phase_name: str
    configuration: int
    step: int
    phase: Phase
    attempt: int
    steps: int
    target: tuple[float, ...]
    unknown: bool
    goal: tuple[float, ...]
    reading: LastReading
    readings: int
    question: str
    by_device: bool
    done: int
    given_up: int
    total: int

    @property
    def load_awaited(self) -> bool:
        """Whether a load is to be brought on or released now."""
        return self.state in (RunState.LOADING, RunState.UNLOADING)

    @property
    def waits_for(self) -> Party:
        """Who is waited for."""
        match self.state:
            case RunState.READY:
                return Party.OPERATOR if self.paused else Party.GUARD
            case RunState.MOVING | RunState.SETTLING:
                return Party.ROBOT
            case RunState.LOADING | RunState.UNLOADING:
                return Party.LOAD_DEVICE if self.by_device else Party.OPERATOR
            case RunState.READING:
                return Party.INSTRUMENTS
        return Party.NOBODY

    @property
    def text(self) -> str:
        """What is being done, one line."""
        if self.state is RunState.READY:
            return f"{'paused' if self.paused else 'waiting'} before the next motion or load step"
        names = {"startup": "the start-up cycle", "reference": "reference"}
        place = names.get(self.item, f"configuration {self.configuration}")
        if self.item == "configuration" and self.state is not RunState.MOVING:
            place += f", step {self.step + 1} of {self.steps}"
        return DOING[self.state].format(place=place)

    @property
    def waiting(self) -> str:
        """What is waited for, and from whom, one line; empty: nothing."""
        match self.waits_for:
            case Party.OPERATOR if self.load_awaited:
                force = ", ".join(f"{value:.0f}" for value in self.target[:3])
                what = f"pull with ({force}) N" if any(self.target) else "release the load"
                what += " that another run may have left on" if self.unknown else ""
                return f"operator: {what}, then confirm"
            case Party.OPERATOR:
                return f"operator: {self.question or 'resume when it is safe to go on'}"
            case Party.GUARD:
                return "guard: permission to move"
            case Party.ROBOT:
                return f"robot: {self.state.value}"
            case Party.LOAD_DEVICE:
                return f"load device: {self.state.value}"
            case Party.INSTRUMENTS:
                return "instruments: a settled window"
        return ""
