"""Carries out what the procedure says: one thread, one queue of events, nothing that blocks.

Answers of drivers and instruments, the guard's word and the operator's come into the queue from other threads; the
thread hands them to the pure procedure, and does what it commands.  Arrival, standstill and the age of the guard's word
are looked at between events.
"""

from __future__ import annotations

import dataclasses
import math
import queue
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from calibration.cell.clients import Measured
from calibration.cell.port import CellPort
from calibration.cell.reading_checks import ReadingError
from calibration.cell.watches import PermissionWatch
from calibration.motion.arrival import Joints
from calibration.motion.backends import Backend, End
from calibration.motion.prover import Prover
from calibration.motion.stop import Stopper
from calibration.sequencer.goal import Goal, Stage
from calibration_core.errors import SessionError, TrajectoryError
from calibration_core.measurement import messages as m
from calibration_core.measurement.sequence import Sequence
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits, Trajectory, plan_motion
from calibration_core.planning.plans.plan import REFERENCE_NUMBER
from calibration_core.timeseries import NANOSECONDS, Float1D

LOOK = 0.02  # s of wall time between two looks while nothing happens: what is heard comes on a tick as long
TICK = 0.1  # s of wall time between two ticks of the procedure
CALM = 10.0  # s, a robot may take to come to rest before it is moved
LATE = 3.0  # s, joint states may lag behind a driver's success, and ...
OLD = 20.0  # s, where their stamps say that they are older than that
SLACK = 1.5  # times a trajectory's length, and ...
SLACK_TIME = 10.0  # s more, a motion may take
PATIENCE = 2.0  # s of wall time, joint states may come after the averages of the same window
WIND_DOWN = 1.2  # s of wall time, the robot has to come to rest at the end
STAGES = {
    m.RunState.IDLE: Stage.READY,
    m.RunState.READY: Stage.READY,
    m.RunState.MOVING: Stage.MOVING,
    m.RunState.LOADING: Stage.LOADING,
    m.RunState.UNLOADING: Stage.LOADING,
    m.RunState.SETTLING: Stage.SETTLING,
    m.RunState.READING: Stage.READING,
    m.RunState.FINISHED: Stage.ENDING,
}
UNSEEN = "it has not been seen in this run that the guard can stop the robot"


@dataclasses.dataclass(frozen=True)
class Since:
    """A moment by the cell's clock and by the steady one: a simulation outruns life, and a cell's clock may jump.

    Attributes:
        cell: s, of the cell.
        steady: s, of wall time.
    """

    cell: float
    steady: float = dataclasses.field(default_factory=time.monotonic)

    def longer(self, now: float, seconds: float) -> bool:
        """Return whether more than so many seconds have passed by both clocks; `now` is of the cell."""
        return min(now - self.cell, time.monotonic() - self.steady) > seconds


@dataclasses.dataclass(frozen=True)
class MotionEnded:
    """The driver's word on the motion of a request."""

    request: int
    how: End
    text: str


@dataclasses.dataclass(frozen=True, eq=False)
class MeasuredFor:
    """The instruments' answer to a request."""

    request: int
    measured: Measured
    since: float = dataclasses.field(default_factory=time.monotonic)


@dataclasses.dataclass(frozen=True)
class Call:
    """Something to be done in this thread."""

    work: Callable[[], None]


@dataclasses.dataclass(eq=False)
class _Motion:
    """A motion that was asked for."""

    request: int
    goal: Float1D
    asked: Since
    trajectory: Trajectory | None = None
    begun: Since | None = None
    allowed: float = math.inf  # s, from its begin to its end
    ended: MotionEnded | None = None
    ended_at: Since | None = None


class Runner:
    """Runs a procedure to its end.

    Attributes:
        sequence: The procedure.
    """

    def __init__(
        self,
        goal: Goal,
        sequence: Sequence,
        cell: CellPort,
        backend: Backend,
        joints: Joints,
        watch: PermissionWatch,
        monitored: Monitored,
        limits: MotionLimits,
        prover: Prover,
        stopper: Stopper,
        *,
        settle_time: float,
    ) -> None:
        """Prepare; `run` begins.

        Args:
            goal: What is run: its events are heard, and its moves made, until it is asked to end.
            sequence: The procedure.
            cell: What carries out its commands.
            backend: Moves the robot.
            joints: The joint states.
            watch: The guard's word.
            monitored: Points whose speed is bounded.
            limits: Of motions.
            prover: Shows the guard that it can stop the robot, before the first motion.
            stopper: Stops the robot.
            settle_time: s, that everything has to stand before a reading.
        """
        self._goal, self._events = goal, goal.events
        self.sequence, self._cell, self._backend, self._joints = sequence, cell, backend, joints
        self._watch, self._monitored, self._limits, self._settle_time = watch, monitored, limits, settle_time
        self._prover, self._stopper = prover, stopper
        self._motion: _Motion | None = None
        self._settling: tuple[int, float] | None = None  # request, since
        self._reading: dict[int, m.TakeReading] = {}
        self._behind: MeasuredFor | None = None
        self._sound_since: float | None = (
            None  # s of the steady clock, from which on the robot has to be as it was then
        )
        self._unsensed = math.inf  # s of the steady clock, since when nobody knows whether something pulls
        self._ticked = -math.inf
        self.finish: m.Finish | None = None

    @property
    def moving(self) -> bool:
        """Whether a motion of ours is under way, or being stopped."""
        return (self._motion is not None and self._motion.trajectory is not None) or self._stopper.under_way

    @property
    def stopping(self) -> bool:
        """Whether a motion of ours is being stopped."""
        return self._stopper.under_way

    @property
    def stage(self) -> Stage:
        """Where the run is in the life of its goal."""
        if self.finish is not None:
            return Stage.ENDING
        if self._prover.running:
            return Stage.PROVING
        return Stage.MOVING if self.moving else STAGES[self.sequence.state]

    def post(self, event: m.Event | MotionEnded | MeasuredFor | Call) -> None:
        """Put an event into the queue, from any thread; the `now` of ResumeMotion is s of the steady clock."""
        self._events.put(event)

    def run(self, *, held: bool = False) -> m.Finish:
        """Run to the end; return how it ended.  `held`: nothing moves before the operator resumes motion."""
        self._prover.reset()
        self._handle(m.Start(self._cell.seconds(), held))
        try:
            self._listen(0.0)
            while self.finish is None:
                self._look()
                self._listen(LOOK)
        except BaseException:
            if self.moving:
                self._stop()
            raise
        finally:
            self._wind_down()
        return self.finish

    def _listen(self, seconds: float) -> None:
        """Take all that has come, within so many s at least; nothing of it matters once the goal is to end."""
        wait = seconds
        while self.finish is None:
            if (asked := self._goal.asked) is not None:
                self._handle(m.Stop(self._cell.seconds(), asked.value))
                return
            try:
                event = self._events.get(timeout=wait) if wait else self._events.get_nowait()
            except queue.Empty:
                return
            self._take(event)
            wait = 0.0

    def _take(self, event: Any) -> None:
        match event:
            case None:
                return
            case Call():
                event.work()
            case MotionEnded():
                if self._motion is not None and self._motion.request == event.request:
                    self._motion.ended, self._motion.ended_at = event, Since(self._cell.seconds())
            case MeasuredFor():
                self._on_measured(event)
            case m.ResumeMotion() if event.now < self._watch.against:
                return  # said before what it would have to follow
            case m.Resume() | m.ResumeMotion() if lost := self._cell.lost(time.monotonic()):
                self._ask(f"{lost}: put that right, then resume")
            case _:
                now = self._cell.seconds()
                self._look_at_guard(time.monotonic(), now)  # what is said now answers its word of now
                self._handle(dataclasses.replace(event, now=now))

    def _handle(self, event: m.Event) -> None:
        commands = self.sequence.handle(event)
        for command in sorted(commands, key=lambda one: not isinstance(one, m.StopMotion)):
            self._do(command)  # a stop does not wait for what is written on the disk

    def pause(self, why: str) -> None:
        """Begin nothing more before the operator says so, who is asked why; in the runner's thread."""
        self._handle(m.Pause(self._cell.seconds()))
        self._ask(why)

    def _ask(self, text: str) -> None:
        self._cell.carry_out(m.AskOperator(text))
        self.sequence.asked(text)

    # --- commands ----------------------------------------------------------------------------------------------------

    def _do(self, command: m.Command) -> None:
        match command:
            case m.Move():
                self._motion = _Motion(command.request, np.asarray(command.q), Since(self._cell.seconds()))
            case m.StopMotion():
                self._stop()
            case m.RequestLoad():
                self._cell.apply_load(command, self._load_answered(command.request))
            case m.AwaitSettled():
                self._settling = (command.request, self._cell.seconds())
            case m.BeginAttempt():
                self._sound_since = None
                self._cell.carry_out(command)
            case m.TakeReading():
                self._reading[command.request] = command
                if self._sound_since is None or command.configuration == REFERENCE_NUMBER:
                    self._sound_since = time.monotonic()
                request = command.request
                self._cell.measure(command.configuration, lambda measured: self.post(MeasuredFor(request, measured)))
            case m.Finish():
                self.finish = command
            case _:
                self._cell.carry_out(command)

    def _stop(self) -> None:
        self._motion = None
        self._stopper.begin(time.monotonic())

    def _load_answered(self, request: int) -> Callable[[bool, str], None]:
        def answered(success: bool, text: str) -> None:
            now = self._cell.seconds()
            self.post(m.LoadReached(now, request) if success else m.LoadFailed(now, request, text))

        return answered

    def _on_measured(self, event: MeasuredFor) -> None:
        command = self._reading.get(event.request)
        if command is None:
            return
        now = self._cell.seconds()
        if event.measured.fault:
            self._cell.exclude(command, event.measured.excluded)
            del self._reading[event.request]
            self._handle(m.ReadingFailed(now, event.request, event.measured.fault))
            return
        means = [*event.measured.points, *filter(None, [event.measured.wrench])]
        steady = time.monotonic()
        behind = max(mean.end for mean in means) > self._joints.until or not self._cell.recorded(event.since)
        if (behind or not self._watch.judged(event.since)) and steady - event.since < PATIENCE:
            self._behind = (
                event  # joint states of the same window, the recorder's word and the guard's are on their way
            )
            return
        del self._reading[event.request]
        if not self._cell.recorded(event.since):
            self._handle(m.ReadingFailed(now, event.request, "the recorder gave no sign of life after it"))
            return
        unsound = self._watch.unsound(steady if self._sound_since is None else self._sound_since, steady)
        if not unsound and not self._watch.judged(event.since):
            unsound = "the state of the robot was not heard after it"
        if unsound:  # however short it was: nothing moves again before the operator says so
            self._handle(m.PermissionChanged(now, permitted=False, reason=unsound, ready=False))
            why = f"{unsound}: the configuration begins again"
            self._handle(m.ReadingFailed(now, event.request, why, moved=True))
            return
        try:
            self._cell.confirm(command, event.measured)
        except ReadingError as error:
            if error.resume:  # somebody or something has moved robot, targets or tracker: nobody knows what else
                self._handle(m.Pause(now))
            self._handle(m.ReadingFailed(now, event.request, str(error), moved=bool(error.resume)))
            if error.resume:
                self._ask(f"{error}: {error.resume}")
            return
        except SessionError as error:
            self._handle(m.ReadingFailed(now, event.request, str(error)))
            return
        self._handle(m.ReadingConfirmed(now, event.request))

    # --- between events ----------------------------------------------------------------------------------------------

    def _look(self) -> None:
        steady, now = time.monotonic(), self._cell.seconds()
        self._look_at_guard(steady, now)
        self._backend.tick(steady)
        self._prove(steady)
        self._cell.look(steady)
        self._look_at_equipment(steady)
        self._stopper.advance(steady, self._joints.standing)
        behind, self._behind = self._behind, None
        if behind is not None:
            self._on_measured(behind)
        if self._motion is not None:
            self._follow(self._motion, now)
        if self._settling is not None and self.sequence.state is not m.RunState.SETTLING:
            self._settling = None
        if self._settling is not None:
            request, since = self._settling
            if now - since >= self._settle_time and self._joints.standing():
                self._settling = None
                self._handle(m.Settled(now, request))
        if steady - self._ticked >= TICK:
            self._ticked = steady
            if self.sequence.about_to_move:
                self._nothing_pulls(steady)
            self._handle(m.Tick(now))
            self._cell.progress()

    def _look_at_guard(self, steady: float, now: float) -> None:
        permitted, text = self._watch.at(steady)
        if permitted and not self._prover.proven:
            permitted, text = False, UNSEEN
        ready = permitted or self._watch.ready(steady)
        self._handle(m.PermissionChanged(now, permitted, text, ready))  # passed over where nothing has changed
        self._handle(m.GuardHearing(now, self._watch.hears(steady)))

    def _prove(self, steady: float) -> None:
        """Have the guard prove that it can stop the robot, once a motion is wanted and nothing else is in its way."""
        prover = self._prover
        sequence = self.sequence
        waits = sequence.state is m.RunState.READY and not sequence.paused and not self._stopper.under_way
        rested = waits and sequence.about_to_move and not prover.proven and prover.rested(steady)
        if prover.running:
            prover.tick(steady)
        elif self._watch.unproven:
            prover.proven = not self._backend.commands
        if prover.fault:
            self.pause(f"the stop cannot be proven: {prover.fault}; resume to try again")
            prover.reset()
        elif rested and self._stands(steady) and self._nothing_pulls(steady):
            self._goal.move(lambda: prover.begin(steady))

    def _nothing_pulls(self, steady: float) -> bool:
        """Tell whether, by the sensor, nothing pulls: else nothing moves, not even for the proof of the stop."""
        if self.moving or self._prover.running:
            return True  # it was seen before; a moving sensor feels the tool's inertia
        pulls = self._cell.pulls()
        if pulls is not None:
            self._unsensed = math.inf
            self._handle(m.LoadSensed(self._cell.seconds(), pulls))
            return not pulls
        self._unsensed = min(self._unsensed, steady)
        if steady - self._unsensed > CALM and not self.sequence.paused:
            self._unsensed = math.inf
            self.pause("the force/torque sensor is silent, what pulls is not known: put that right, then resume")
        return False

    def _stands(self, steady: float) -> bool:
        """Tell whether the robot stands, and nothing but a missing proof speaks against motion."""
        return self._watch.ready(steady) and self._joints.standing()

    def _look_at_equipment(self, steady: float) -> None:
        """Pause where what is measured would not be recorded, or could not be measured; nothing begins after that."""
        if not self.sequence.paused:
            self.lose(self._cell.lost(steady))

    def lose(self, lost: str) -> None:
        """Pause for what is lost, if anything is; in the runner's thread."""
        if lost and not self.sequence.paused:
            self.pause(f"{lost}: put that right, then resume")

    def _follow(self, motion: _Motion, now: float) -> None:
        """Begin the motion once the robot stands, and see how it goes."""
        if motion.trajectory is None:
            self._begin(motion, now)
        elif motion.ended is not None and motion.ended.how is End.CANCELLED:
            why = motion.ended.text  # whoever stopped it had a reason: nothing moves before the operator says so
            self.pause(f"{why}: resume when it is safe to go on")
        elif motion.ended is not None and motion.ended.how is End.FAILURE:
            self._blocked(motion, now, motion.ended.text or "the driver gave up")
        elif (motion.ended is not None or not self._backend.answers) and self._joints.arrived(motion.goal):
            self._motion = None
            self._handle(m.Arrived(now, motion.request))
        elif (end := motion.ended_at) and end.longer(now, LATE if self._joints.reached(end.cell + LATE) else OLD):
            off = np.abs(np.asarray(self._joints.latest) - motion.goal).max()
            self._blocked(motion, now, f"the driver says that it is there, but a joint is {off:.4f} rad off")
        elif motion.begun is not None and motion.begun.longer(now, motion.allowed):
            self._stop()
            self._handle(m.Blocked(now, motion.request, "the motion takes too long"))

    def _begin(self, motion: _Motion, now: float) -> None:
        if not self._cell.ready(motion.asked.steady) or not self._nothing_pulls(time.monotonic()):
            return  # they are lost if this lasts
        where = self._joints.latest
        fresh = self._joints.reached(motion.asked.cell)  # older ones say where it stood
        if where is None or not fresh or self._stopper.under_way or not self._joints.standing():
            if motion.asked.longer(now, CALM):
                self._unknown(motion, now, late=where is not None and not fresh)
            return
        try:
            motion.trajectory = plan_motion(self._monitored, where, motion.goal, self._limits)
        except TrajectoryError as error:
            self._blocked(motion, now, str(error))
            return
        if not self._watch.at(time.monotonic())[0]:
            motion.trajectory = None  # lost while it was planned; the procedure hears of it next
            return
        if self._backend.commands:
            scaling = self._cell.scaling()
            pace = scaling if 0.0 < scaling <= 1.0 else 1.0
            motion.allowed = SLACK * motion.trajectory.duration / pace + SLACK_TIME
        motion.begun = Since(now)
        path, request = motion.trajectory, motion.request
        if not self._goal.move(
            lambda: self._backend.move(path, lambda how, text: self.post(MotionEnded(request, how, text)))
        ):
            motion.trajectory = None

    def _unknown(self, motion: _Motion, now: float, *, late: bool) -> None:
        """Give a motion up that cannot begin: another try would fare no better where the joint states are late."""
        if late:
            behind = now - self._joints.until / NANOSECONDS
            self.pause(f"the joint states are {behind:.1f} s behind the clock: put that right, then resume")
        else:
            self._blocked(motion, now, "the robot does not come to rest, or its joint states do not come")

    def _blocked(self, motion: _Motion, now: float, reason: str) -> None:
        self._motion = None
        self._handle(m.Blocked(now, motion.request, reason))

    def _wind_down(self) -> None:
        """Take the stages of the stop until the robot stands, for a while."""
        if self._prover.running:
            self._backend.stop()
        end = time.monotonic() + WIND_DOWN
        while self._stopper.under_way and time.monotonic() < end:
            self._stopper.advance(time.monotonic(), self._joints.standing)
            time.sleep(LOOK)
