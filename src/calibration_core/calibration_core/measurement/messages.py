"""What the measurement procedure hears (events) and says (commands).

Events and the commands that they answer carry the same `request`: an answer to an earlier request is out of date and is
passed over.  Times are s on the caller's clock.
"""

from __future__ import annotations

import dataclasses
import enum

from calibration_core.recording.definitions.own import POINT_EXCLUDED
from calibration_core.timeseries import Float1D, Phase


@dataclasses.dataclass(frozen=True)
class Start:
    """The operator wants the plan measured.

    Where motion is not permitted then, for more than a missing proof of the stop, it is `held`: nothing moves before
    the operator says so, whatever is reset or switched on meanwhile.
    """

    now: float
    held: bool = False


@dataclasses.dataclass(frozen=True)
class Tick:
    """Time goes on."""

    now: float


@dataclasses.dataclass(frozen=True)
class PermissionChanged:
    """The guard permits motion, or does not (any more).

    `ready`: at most the proof of the stop is missing, which the procedure waits for.  Anything else that speaks against
    motion is for an operator to put right, who then resumes motion by name.
    """

    now: float
    permitted: bool
    reason: str = ""
    ready: bool = True


@dataclasses.dataclass(frozen=True)
class GuardHearing:
    """The guard hears our sign of life, or does not (any more).

    One that does not hear it could not stop a motion that nobody watches any more: none begins.
    """

    now: float
    hears: bool


@dataclasses.dataclass(frozen=True)
class LoadSensed:
    """What the sensor says while nothing should pull, before a motion begins.

    `pulls` says what does, or why nobody knows it; empty: nothing pulls.  Nothing moves before it was released.
    """

    now: float
    pulls: str


@dataclasses.dataclass(frozen=True)
class Arrived:
    """The robot stands where `Move` sent it, checked against its joint states."""

    now: float
    request: int


@dataclasses.dataclass(frozen=True)
class Blocked:
    """The robot cannot get there, or did not."""

    now: float
    request: int
    reason: str


@dataclasses.dataclass(frozen=True)
class LoadReached:
    """The load is on, by the load device's or the operator's word."""

    now: float
    request: int


@dataclasses.dataclass(frozen=True)
class LoadFailed:
    """The load cannot be applied, or released."""

    now: float
    request: int
    reason: str


@dataclasses.dataclass(frozen=True)
class Settled:
    """Joints, wrench and points stand still."""

    now: float
    request: int


@dataclasses.dataclass(frozen=True)
class ReadingConfirmed:
    """The readings of all points are on the disk."""

    now: float
    request: int


@dataclasses.dataclass(frozen=True)
class ReadingFailed:
    """No reading could be taken: a target not seen, too few samples, never at rest, not what was planned.

    Where the robot was `moved` from its posture, its brakes were on, or tracker or targets were moved, another try
    there tells nothing: the configuration begins again, which counts for no failure of it.
    """

    now: float
    request: int
    reason: str
    moved: bool = False


@dataclasses.dataclass(frozen=True)
class Pause:
    """The operator wants a pause: a motion stops, a reading under way is finished, nothing new begins."""

    now: float


@dataclasses.dataclass(frozen=True)
class Resume:
    """The operator wants to go on after a pause; after a loss of permission this does not suffice."""

    now: float


@dataclasses.dataclass(frozen=True)
class ResumeMotion:
    """The operator, by name, wants the robot to move again after a loss of permission."""

    now: float
    operator: str


@dataclasses.dataclass(frozen=True)
class Redo:
    """The operator wants the configuration under way measured again from its beginning, or, with `skip`, left out.

    Where a load device `moves_load`, a change of the load that is under way comes to its end first.
    """

    now: float
    skip: bool = False
    moves_load: bool = False


@dataclasses.dataclass(frozen=True)
class Stop:
    """Somebody wants an end; the reason says who."""

    now: float
    reason: str = "stopped by the operator"


@dataclasses.dataclass(frozen=True)
class Fault:
    """Robot, load device or instrument cannot go on."""

    now: float
    reason: str


@dataclasses.dataclass(frozen=True)
class Enough:
    """What is wanted is known: the present configuration is finished, and nothing follows."""

    now: float
    text: str


Answer = Arrived | Blocked | LoadReached | LoadFailed | Settled | ReadingConfirmed | ReadingFailed
Event = (
    Start | Tick | PermissionChanged | GuardHearing | LoadSensed | Arrived | Blocked | LoadReached | LoadFailed
    | Settled | ReadingConfirmed | ReadingFailed | Pause | Resume | ResumeMotion | Redo | Stop | Fault | Enough
)  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class Move:
    """Move to `q` (n,) rad from wherever the robot stands, once it stands; answered by `Arrived` or `Blocked`."""

    request: int
    q: Float1D
    configuration: int


@dataclasses.dataclass(frozen=True)
class StopMotion:
    """Stop the motion at once."""

    reason: str


@dataclasses.dataclass(frozen=True, eq=False)
class RequestLoad:
    """Apply `wrench` (6,) N and N*m, base axes, at the wrench point; answered by `LoadReached` or `LoadFailed`.

    Attributes:
        unknown: Nobody knows what pulls, or something does that should not: it is released before anything moves.
    """

    request: int
    configuration: int
    step: int
    wrench: Float1D
    unknown: bool = False


@dataclasses.dataclass(frozen=True)
class AwaitSettled:
    """Watch until everything stands still; answered by `Settled` or `ReadingFailed`."""

    request: int
    configuration: int
    step: int


@dataclasses.dataclass(frozen=True, eq=False)
class TakeReading:
    """Read all points and store them; answered by `ReadingConfirmed` once on the disk, or `ReadingFailed`.

    The robot is to stand at `q` (n,) rad, under `wrench` (6,) N and N*m, base axes, at the wrench point.
    """

    request: int
    configuration: int
    step: int
    attempt: int
    q: Float1D
    wrench: Float1D


@dataclasses.dataclass(frozen=True)
class Mark:
    """Announce what happens from now on (`/calibration/step`)."""

    configuration: int
    step: int
    phase: Phase


@dataclasses.dataclass(frozen=True)
class BeginAttempt:
    """A configuration is approached; `attempt` counts from 0 for each configuration."""

    configuration: int
    attempt: int


@dataclasses.dataclass(frozen=True)
class EndAttempt:
    """The attempt is over: measured completely, or given up for a reason."""

    configuration: int
    attempt: int
    completed: bool
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class AskOperator:
    """Show a person what is needed."""

    text: str


class Kind(enum.IntEnum):
    """Kinds of events worth recording; the numbers are those of `SessionEvent` messages."""

    STARTED = 0
    RESUMED = 1
    WARM_UP = 2
    REFERENCE = 3
    CONFIGURATION_STARTED = 4
    CONFIGURATION_DONE = 5
    CONFIGURATION_RETRIED = 6
    CONFIGURATION_SKIPPED = 7
    SPARE_USED = 8
    LOAD_APPLIED = 9
    PAUSED = 10
    CONTINUED = 11
    STOP_COMMANDED = 12
    PERMISSION_LOST = 13
    PERMISSION_GAINED = 14
    FAULT = 15
    OPERATOR_ASKED = 16
    FINISHED = 17
    ABORTED = 18
    PHASE = 19
    CONDITION_VIOLATED = 20
    CONDITION_OVERRIDDEN = 21
    ENOUGH = 22
    LOAD_OVERRIDDEN = 23
    READING_REJECTED = 24
    REJECTED = 25
    POINT_EXCLUDED = POINT_EXCLUDED


@dataclasses.dataclass(frozen=True)
class Record:
    """Write down that something happened."""

    kind: Kind
    configuration: int
    step: int
    text: str


class RunState(enum.Enum):
    """What the procedure waits for."""

    IDLE = "the start"
    READY = "permission, or the operator, to begin what comes next"
    MOVING = "arrival"
    SETTLING = "standstill"
    LOADING = "the load"
    READING = "the reading"
    UNLOADING = "the load's release"
    FINISHED = "nothing"


WORKING = frozenset({RunState.MOVING, RunState.SETTLING, RunState.LOADING, RunState.READING, RunState.UNLOADING})


class Outcome(enum.Enum):
    """How the procedure ended."""

    COMPLETED = "as many configurations as planned are measured"
    INCOMPLETE = "some configurations could not be measured, and the spares are used up"
    STOPPED = "stopped by the operator"
    FAULT = "a fault"


@dataclasses.dataclass(frozen=True)
class Finish:
    """The procedure is over; nothing follows."""

    outcome: Outcome
    text: str


Command = (
    Move | StopMotion | RequestLoad | AwaitSettled | TakeReading | Mark | BeginAttempt | EndAttempt | AskOperator
    | Record | Finish
)  # fmt: skip
