"""The life of a goal of `~/run`: from its acceptance to its result it can be stopped at every moment.

A stop, a cancel and the end of the node are requests on the goal.  They are kept until it has ended: whoever waits for
it gives up, no motion begins any more, and a motion under way is stopped at once.  `TABLE` says what becomes of every
request at every stage.
"""

from __future__ import annotations

import enum
import functools
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import Outcome, SessionEvent
from rclpy.action import CancelResponse, GoalResponse

from calibration.cell.conditions_watch import fault
from calibration.conversions import to_header, to_outcome
from calibration.rclpy_gaps import Background, hidden
from calibration_core.cell import Cell
from calibration_core.errors import CalibrationError, InputError, SessionError
from calibration_core.measurement.session import DATABASE
from calibration_core.planning.plans.plan_file import read_plan

NAME = "~/run"
LOOK = 0.02  # s of wall time, between two looks at what is waited for
GRACE = 5.0  # s, that a client may take to be found in the graph


class Stage(enum.Enum):
    """Where a goal is in its life; its words say what was being done."""

    NONE = "no plan is being measured"
    ACCEPTED = "the goal was accepted"
    NODES = "the cell's nodes and drivers were waited for"
    GUARD = "the guard was waited for"
    SESSION = "the session was being opened"
    RECORDER = "the recorder was waited for"
    READY = "the next step was waited for"
    PROVING = "the stop was being proven"
    MOVING = "the robot was being moved"
    LOADING = "the load was being changed"
    SETTLING = "standstill was waited for"
    READING = "a reading was being taken"
    ENDING = "the run was ending"


class Request(enum.Enum):
    """What can be asked about a goal; the words of what ends it say who wanted that."""

    GOAL = "another goal"
    CANCEL = "cancelled by whoever asked for the run"
    STOP = "stopped by the operator"
    END = "the sequencer was told to end"
    PAUSE = "pause"
    RESUME = "resume"
    ACT = "resume motion, repeat, skip, confirm a load, override a condition"


class Answer(enum.Enum):
    """What becomes of a request; the words of a refusal say why."""

    BEGIN = "the life of the goal begins"
    KEEP = "kept: waits are given up, and nothing moves any more"
    HALT = "kept, and what moves is stopped at once"
    QUEUE = "the procedure hears it"
    BUSY = "a plan is being measured"
    NOTHING = "no plan is being measured"
    EARLY = "the run has not begun yet"
    LATE = "the run is ending"

    @property
    def refusal(self) -> str:
        """Why the request is refused; empty: it is not."""
        return self.value if self in (Answer.BUSY, Answer.NOTHING, Answer.EARLY, Answer.LATE) else ""


_NOTHING = (Answer.BEGIN, *[Answer.NOTHING] * 6)
_PREPARING = (Answer.BUSY, *[Answer.KEEP] * 3, Answer.QUEUE, Answer.QUEUE, Answer.EARLY)
_AT_REST = (Answer.BUSY, *[Answer.KEEP] * 3, *[Answer.QUEUE] * 3)
_IN_MOTION = (Answer.BUSY, *[Answer.HALT] * 3, *[Answer.QUEUE] * 3)
_ENDING = (Answer.BUSY, *[Answer.HALT] * 3, *[Answer.LATE] * 3)
TABLE = {
    stage: dict(zip(Request, answers, strict=True))
    for stage, answers in {
        # what is asked: GOAL, CANCEL, STOP, END, PAUSE, RESUME, ACT
        Stage.NONE: _NOTHING,
        Stage.ACCEPTED: _PREPARING,
        Stage.NODES: _PREPARING,
        Stage.GUARD: _PREPARING,
        Stage.SESSION: _PREPARING,
        Stage.RECORDER: _PREPARING,
        Stage.READY: _AT_REST,
        Stage.PROVING: _IN_MOTION,
        Stage.MOVING: _IN_MOTION,
        Stage.LOADING: _AT_REST,
        Stage.SETTLING: _AT_REST,
        Stage.READING: _AT_REST,
        Stage.ENDING: _ENDING,
    }.items()
}


class GoalEndedError(CalibrationError):
    """A goal was asked to end while something was waited for; the text says by whom, and what was waited for."""


class Goal:
    """One goal, from its acceptance to its result.

    Attributes:
        handle: Of the action's server.
        events: What the run hears; what comes before it begins is heard then.
        asked: What ends it, once that was asked for: CANCEL, STOP or END.
    """

    def __init__(self, handle: Any, halt: Callable[[], None]) -> None:
        """Take the goal's handle, and what stops a motion that is under way; it may be called from any thread."""
        self.handle, self._halt = handle, halt
        self.events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.asked: Request | None = None
        self._stage, self._runner = Stage.ACCEPTED, None
        self._lock = threading.Lock()
        self._asking = threading.Event()

    @property
    def stage(self) -> Stage:
        """Where it is in its life."""
        runner: Any = self._runner
        return self._stage if runner is None or self._stage is Stage.ENDING else runner.stage

    def take(self, request: Request, event: object = None) -> Answer:
        """Take a request, from any thread; `event` is what the procedure hears of one that is for it."""
        with self._lock:  # no motion begins meanwhile: one that has begun is seen by the stage
            answer = TABLE[self.stage][request]
            if answer in (Answer.KEEP, Answer.HALT):
                self.asked = self.asked or request
                self._asking.set()
        if answer is Answer.HALT:
            self._halt()
        if not answer.refusal:
            self.events.put(event)  # None: it wakes whoever waits for events
        return answer

    # --- for the thread that measures --------------------------------------------------------------------------------

    def enter(self, stage: Stage) -> None:
        """Come to a stage before the run.

        Raises:
            GoalEndedError: It was asked to end.
        """
        self._look()
        self._stage = stage

    def begin(self, runner: Any) -> None:
        """Come to the run, whose `stage` says where it is."""
        self._runner = runner

    def end(self) -> None:
        """Come to the end of the run, or of what came before it."""
        self._stage = Stage.ENDING

    def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait for a condition, at most so many s of wall time; return whether it came true.

        Raises:
            GoalEndedError: The goal was asked to end.
        """
        end = time.monotonic() + seconds
        while True:
            self._look()
            if condition():
                return True
            if time.monotonic() > end:
                return False
            self._asking.wait(LOOK)

    def _look(self) -> None:
        if self.asked is not None:
            raise GoalEndedError(f"{self.asked.value} while {self.stage.value}; nothing was moved")

    def move(self, command: Callable[[], None]) -> bool:
        """Give a command that moves the robot, unless the goal was asked to end; return whether it was given."""
        with self._lock:
            if self.asked is None:
                command()
            return self.asked is None


class RunAction:
    """Takes goals, one at a time, has them measured, and tells their ends.

    Attributes:
        goal: The one that is alive; None: there is none.
    """

    def __init__(
        self,
        node: Any,
        measure: Callable[[Goal], Any],
        against: Callable[[], str],
        halt: Callable[[], None],
    ) -> None:
        """Offer the action.

        Args:
            node: The sequencer: its run (`runner`, `port`), `feedback`, `events`, `cell` and diagnostics.
            measure: Measures the plan of a goal, in a thread of its own; returns the result.
            against: Says what speaks against any run now; empty: nothing.
            halt: Stops a motion of a run that is under way.
        """
        self._node, self._measure, self._against, self._halt = node, measure, against, halt
        self.goal: Goal | None = None
        self._over = threading.Event()
        self._over.set()
        node.create_action_server(
            RunPlan, NAME, lambda _: None, goal_callback=self._on_goal, cancel_callback=self._on_cancel,
            handle_accepted_callback=self._on_accepted,
        )  # fmt: skip

    def take(self, request: Request, event: object = None) -> Answer:
        """Take a request on the goal that is alive."""
        goal = self.goal
        return TABLE[Stage.NONE][request] if goal is None else goal.take(request, event)

    def wait(self, seconds: float) -> bool:
        """Wait for the end of a run; return whether it has ended."""
        return self._over.wait(seconds)

    def _on_goal(self, request: Any) -> GoalResponse:
        """Reject what cannot be begun; as a rejected goal carries no words, they are told otherwise."""
        node = self._node
        why = self._against() or self.take(Request.GOAL).refusal or unusable(request, node.cell)
        if not why:
            return GoalResponse.ACCEPT
        node.get_logger().error(f"the goal is rejected: {why}")
        node.diagnostics.report("run", 1, f"the goal is rejected: {why}")
        header = to_header(node.now_ns())
        node.events.publish(SessionEvent(header=header, kind=SessionEvent.REJECTED, source="sequencer", text=why))
        return GoalResponse.REJECT

    def _on_accepted(self, handle: Any) -> None:
        self.goal = Goal(handle, self._halt)
        self._over.clear()
        handle.execute(functools.partial(self._on_run, self.goal))

    def _on_cancel(self, handle: Any) -> CancelResponse:
        own = self.goal is not None and self.goal.handle is handle
        return CancelResponse.ACCEPT if own and not self.take(Request.CANCEL).refusal else CancelResponse.REJECT

    async def _on_run(self, goal: Goal, handle: Any) -> Any:
        node, result = self._node, RunPlan.Result()
        try:
            node.feedback.prepare(handle.request)
            result = await Background(node, lambda: self._measure(goal))
        except GoalEndedError as ended:
            result.outcome = to_outcome(Outcome.STOPPED, str(ended))
        except (InputError, OSError) as error:  # once a run is under way, it is the disk that cannot be used any more
            self._halt()
            text = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else str(error)
            result.outcome = to_outcome(Outcome.INPUT_UNUSABLE if node.runner is None else Outcome.FAULT, text)
        except Exception as error:  # noqa: BLE001  # a defect of ours: it must reach whoever asked
            node.get_logger().error(f"{type(error).__name__}: {error}")
            self._halt()
            result.outcome = to_outcome(Outcome.INTERNAL, f"{type(error).__name__}: {error}")
        # Not in a `finally`: a coroutine that the ending process closes must not publish, its publishers are gone.
        node.runner = node.port = self.goal = None
        node.feedback.end(str(result.outcome.text))
        self._over.set()
        if handle.is_cancel_requested:
            result.outcome.code = Outcome.CANCELLED
            handle.canceled()
        elif result.outcome.code == Outcome.OK:
            handle.succeed()
        else:
            handle.abort()
        return result


def unusable(request: Any, cell: Cell) -> str:
    """Return why a `RunPlan` goal cannot be begun; empty if it can."""
    directory = Path(request.session)
    try:
        read_plan(request.plan, cell)
        there = (directory / DATABASE).exists()
        if not request.session:
            raise SessionError(directory, "", "no directory", "the directory of the session")
        if there and not request.resume:
            raise SessionError(directory, "", "a session", "a new directory, or resume to continue this one")
        if request.resume and not there:
            raise SessionError(directory, "", "no session", "one to continue, or no resume")
    except InputError as error:
        return str(error)
    return "; ".join(filter(None, map(fault, request.overrides)))


class ClientWatch:
    """Whether anybody still takes the feedback of a run: whose client is gone, nobody minds the robot for.

    A client that ends well leaves the graph at once; one that was killed stands in it for 20 s.  Times are s of the
    steady clock.
    """

    def __init__(self, node: Any) -> None:
        """Look for subscribers of the feedback."""
        self._node, self._topic = node, node.resolve_topic_name(hidden(NAME, "feedback"))
        self._there, self._deadline = False, 0.0

    def begin(self, now: float) -> None:
        """Expect a client from now on."""
        self._there, self._deadline = True, now + GRACE

    def vanished(self, now: float) -> bool:
        """Tell, once, that the last client has gone; one that comes later is minded anew."""
        listening = self._node.count_subscribers(self._topic) > 0
        if listening:
            self._deadline = min(self._deadline, now)
        if listening == self._there or now < self._deadline:
            return False
        self._there = listening
        return not listening
