"""The measurement procedure (CWA 17384, 7.6) as a state machine: events in, commands out; no clock, no ROS, no files.

    move unloaded -> settle -> read -> (load -> settle -> read) for every step -> unload -> next

It moves only while it has the permission and the guard hears that it lives, and only without load: neither one of its
own nor, before every motion, one that the sensor tells of.  A motion that lost its permission is stopped, and nothing
moves again before the operator says so.  What cannot be reached or read is tried again a few times, then left out, and
a spare takes its place.
"""

from __future__ import annotations

import math

import numpy as np

from calibration_core.measurement import messages as m
from calibration_core.measurement.consent import why_not
from calibration_core.measurement.messages import Kind, Outcome, RunState
from calibration_core.measurement.snapshot import UNLOADED, LastReading, ReadingVerdict, Snapshot
from calibration_core.planning.plans.measurement_queue import Item, MeasurementQueue, SequenceRules
from calibration_core.planning.plans.plan import Plan
from calibration_core.timeseries import Float1D, Phase


class Sequence:
    """Runs a plan.

    Attributes:
        queue: What is done and what is left.

    Args:
        plan: What is measured.
        rules: Retries, time limits, repetition of the start-up cycle.
        completed: Configurations measured in an earlier run of the same session.
        given_up: Configurations given up then.
        visits: Visits to the reference then.
        by_device: A load device changes the load, not the operator.
        loaded: A load may be on, for nobody has seen it released: it is released before anything moves, the proof of
            the stop included.
    """

    def __init__(
        self,
        plan: Plan,
        rules: SequenceRules | None = None,
        *,
        completed: frozenset[int] = frozenset(),
        given_up: frozenset[int] = frozenset(),
        visits: int = 0,
        by_device: bool = False,
        loaded: bool = False,
    ) -> None:
        self._rules = rules or SequenceRules()
        self.queue = MeasurementQueue(plan, self._rules, completed, given_up, visits)
        self._resumed = bool(completed or given_up or visits)
        self._state = RunState.IDLE
        self._permitted = self._heard = self._paused = self._held = self._asked = False
        self._item: Item | None = None
        self._at_item = self._open = False  # the robot stands at the present item; an attempt is announced, not ended
        self._step = self._attempt = self._tries = 0  # of the item, of its attempt, of its reading
        self._ready, self._granted = True, 0.0  # granted: attempts that the operator wants beyond the rules; -inf: none
        self._given_up_for = ""  # why the present attempt is being given up; it has to be unloaded first
        self._load: Float1D | None = None if loaded else np.zeros(6)  # None: under way, failed, or not known
        self._wanted = np.zeros(6)
        self._pulls = ""  # what pulls although nothing should
        self._readings: set[int] = set()  # requests for the present reading
        self._request, self._deadline, self._now = 0, math.inf, math.nan
        self._phase: tuple[int, int, Phase] | None = None
        self._out: list[m.Command] = []
        self._by_device, self._question = by_device, ""
        self._reading, self._kept = LastReading(), 0

    @property
    def state(self) -> RunState:
        """What it waits for."""
        return self._state

    @property
    def paused(self) -> bool:
        """Whether nothing new begins before the operator resumes."""
        return self._paused or self._held

    @property
    def held(self) -> bool:
        """Whether the operator has to resume motion by name, for the permission was lost."""
        return self._held

    @property
    def about_to_move(self) -> bool:
        """Whether nothing but permission, operator or standstill is between it and a motion."""
        waits = self._state in (RunState.READY, RunState.MOVING)
        return waits and not self._at_item and not self._may_be_loaded

    @property
    def position(self) -> tuple[int, int, Phase] | None:
        """Configuration, step and phase as last announced."""
        return self._phase

    @property
    def seconds_left(self) -> float:
        """Estimate of the time left, s, without pauses; 0 once it has ended, NaN where nothing is known yet."""
        return 0.0 if self._state is RunState.FINISHED else self.queue.seconds_left

    def asked(self, text: str) -> None:
        """Take note of what the operator is asked by whoever carries the commands out."""
        self._question = text

    def snapshot(self) -> Snapshot:
        """Return how it stands now."""
        state, item = self._state, self._item
        configuration, step, phase = self._phase or (0, 0, Phase.MOVING)
        return Snapshot(
            state=state,
            paused=self.paused,
            held=self._held,
            item="" if item is None else item.kind,
            phase_name=item.phase if item is not None and self.queue.plan.preparation else "",
            configuration=configuration,
            step=step,
            phase=phase,
            attempt=self._attempt,
            steps=1 if item is None else max(len(item.steps), 1),
            target=UNLOADED if state is RunState.MOVING else tuple(self._wanted.tolist()),
            unknown=not self._at_item,
            goal=tuple(item.q.tolist()) if item is not None and state is RunState.MOVING else (),
            reading=self._reading,
            readings=self._kept,
            question=self._question,
            by_device=self._by_device,
            done=len(self.queue.completed),
            given_up=len(self.queue.given_up),
            total=self.queue.target,
        )

    # --- events -------------------------------------------------------------------------------------------------------

    def handle(self, event: m.Event) -> tuple[m.Command, ...]:
        """Take one event; return what is to be done, in order."""
        self._out, self._now = [], event.now
        before = self._state, self.paused
        self.queue.pass_time(event.now, working=self._state in m.WORKING and not self.paused)
        if self._state is not RunState.FINISHED:
            self._dispatch(event)
        asked = [one.text for one in self._out if isinstance(one, m.AskOperator)]
        if asked or before != (self._state, self.paused):
            self._question = asked[-1] if asked else ""
        return tuple(self._out)

    def _dispatch(self, event: m.Event) -> None:
        match event:
            case m.Start() if self._state is RunState.IDLE:
                self._start(event)
            case m.Tick():
                self._tick()
            case m.PermissionChanged() if (event.permitted, event.ready) != (self._permitted, self._ready):
                self._permission(event)
            case m.GuardHearing() if event.hears != self._heard:
                self._hearing(event)
            case m.LoadSensed() if event.pulls != self._pulls:
                self._sensed(event)
            case m.Pause() if not self._paused and self._state is not RunState.IDLE:
                self._paused, self._asked = True, False
                self._say(Kind.PAUSED, "")
                self._interrupt("paused")
            case m.Resume() | m.ResumeMotion() if self.paused:
                self._resume(event)
            case m.Redo() if self._open:
                self._redo(event)
            case m.Enough():
                self.queue.enough(self._item)
                self._say(Kind.ENOUGH, event.text)
            case m.Stop() | m.Fault():
                self._stopped(event)
            case _ if isinstance(event, m.Answer):
                self._answer(event)

    def _answer(self, event: m.Answer) -> None:
        match event, self._state:
            case m.ReadingConfirmed(), _ if event.request in self._readings:
                self._confirmed()  # a late one counts as well: it is on the disk
            case _ if event.request != self._request:
                return
            case m.Arrived(), RunState.MOVING:
                self._arrived()
            case m.Blocked(), RunState.MOVING:
                self._retry_or_skip(event.reason)
            case m.LoadReached(), RunState.LOADING:
                self._load = self._wanted
                self._say(Kind.LOAD_APPLIED, f"{np.linalg.norm(self._wanted[:3]):.0f} N")
                self._advance()
            case m.LoadReached(), RunState.UNLOADING:
                self._load, self._pulls = self._wanted, ""
                self._unloaded() if self._at_item else self._advance()
            case m.LoadFailed(), RunState.LOADING:
                self._give_up(f"load: {event.reason}")
            case m.LoadFailed(), RunState.UNLOADING:
                self._say(Kind.FAULT, event.reason)
                self._end(Outcome.FAULT, f"the load cannot be released: {event.reason}")
            case m.Settled(), RunState.SETTLING:
                self._advance() if self.paused else self._read()
            case m.ReadingFailed(), RunState.SETTLING | RunState.READING:
                self._failed(event.reason, moved=event.moved)

    def _start(self, event: m.Start) -> None:
        self._held = event.held
        text = f"{len(self.queue.completed)} of {self.queue.target} configurations are measured already"
        self._out.append(m.Record(Kind.RESUMED if self._resumed else Kind.STARTED, 0, 0, text if self._resumed else ""))
        self._advance()

    def _tick(self) -> None:
        if self._state is RunState.READY:
            self._advance()
        elif self._now >= self._deadline and self._state is RunState.MOVING:
            self._out.append(m.StopMotion("the motion takes too long"))
            self._retry_or_skip("the motion takes too long")
        elif self._now >= self._deadline:
            self._failed("never at rest" if self._state is RunState.SETTLING else "the reading takes too long")

    def _permission(self, event: m.PermissionChanged) -> None:
        had, self._permitted, self._ready = self._permitted, event.permitted, event.ready
        self._asked = False
        if self._state is RunState.IDLE:
            return
        if had != event.permitted:
            self._say(Kind.PERMISSION_GAINED if event.permitted else Kind.PERMISSION_LOST, event.reason)
        self._held |= not event.permitted and (had or not event.ready)
        self._interrupt(f"permission lost: {event.reason}")

    def _hearing(self, event: m.GuardHearing) -> None:
        """A motion under way goes on: the guard cancels it itself where it must."""
        self._heard = event.hears
        if event.hears and self._permitted and not self.paused:  # nothing else stood in the way: ask anew next time
            self._asked = False
            self._go_on()

    def _sensed(self, event: m.LoadSensed) -> None:
        """Have released what pulls; a motion that has not begun waits for it."""
        self._pulls = event.pulls
        if event.pulls:
            self._interrupt(event.pulls)

    def _stopped(self, event: m.Stop | m.Fault) -> None:
        if isinstance(event, m.Stop):
            self._end(Outcome.STOPPED, event.reason)
            return
        self._say(Kind.FAULT, event.reason)
        self._end(Outcome.FAULT, event.reason)

    def _resume(self, event: m.Resume | m.ResumeMotion) -> None:
        if not self._ready if isinstance(event, m.ResumeMotion) else self._held:
            return  # it would count later
        self._paused = self._held = self._asked = False
        self._say(Kind.CONTINUED, f"by {event.operator}" if isinstance(event, m.ResumeMotion) else "")
        self._go_on()

    def _redo(self, event: m.Redo) -> None:
        """Give the attempt under way up: the operator wants it again, which counts for no failure, or left out."""
        reason = f"{'left out' if event.skip else 'measured again'}, as the operator wants it"
        self._granted = -math.inf if event.skip else self._granted + (not self._given_up_for)
        if self._at_item:
            self._given_up_for = reason
            if not (self._state is RunState.UNLOADING or (self._state is RunState.LOADING and event.moves_load)):
                self._give_up(reason)
            return
        if self._state is RunState.MOVING:
            self._out.append(m.StopMotion(reason))
        self._retry_or_skip(reason)

    def _interrupt(self, reason: str) -> None:
        """Stop a motion; it begins anew, from wherever the robot stands, when the operator resumes."""
        if self._state is RunState.MOVING:
            self._out.append(m.StopMotion(reason))
            self._wait(RunState.READY)
        self._go_on()

    def _go_on(self) -> None:
        if self._state is RunState.READY:
            self._advance()

    # --- the way through a configuration ------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Begin what comes next, if it may begin: a motion, the next step, or the release of the load."""
        self._wait(RunState.READY)
        if self._item is None:
            self._item = self.queue.next(self._now)
            if self._item is None:
                self._complete()
                return
            self._step, self._attempt, self._tries, self._granted = 0, 0, 0, 0.0
        done = self._at_item and (bool(self._given_up_for) or self._step == len(self._item.steps))
        release = (self._may_be_loaded or bool(self._pulls)) and (done or not self._at_item)
        if not self._may_begin(moving=not self._at_item and not release):
            return
        if release:
            self._request_load(np.zeros(6), RunState.UNLOADING, Phase.UNLOADING)
        elif done:
            self._unloaded()
        elif self._at_item:
            self._load_or_settle()
        else:
            self._move()

    def _may_begin(self, *, moving: bool) -> bool:
        text = why_not(self._held, self._paused, self._permitted or not moving, self._heard or not moving)
        if text and not self._asked:
            self._asked = True
            self._out.append(m.AskOperator(text))
            self._say(Kind.OPERATOR_ASKED, text)
        return not text

    def _move(self) -> None:
        item = self._present
        if item.kind == "configuration" and not self._open:
            self._open = True
            if self.queue.phase_begins(item):
                self._say(Kind.PHASE, item.phase)
            self._out.append(m.BeginAttempt(item.number, self._attempt))
        kinds = {"startup": Kind.WARM_UP, "reference": Kind.REFERENCE, "configuration": Kind.CONFIGURATION_STARTED}
        self._say(kinds[item.kind], "")
        self._mark(Phase.MOVING)
        self._wait(RunState.MOVING, self._rules.motion_limit)
        self._out.append(m.Move(self._new(), item.q, item.number))

    def _arrived(self) -> None:
        if len(self._present.steps):
            self._at_item = True
        else:
            self.queue.done(self._present)
            self._item = None
        self._advance()

    def _load_or_settle(self) -> None:
        """Bring on the load of the present step, where it is not on."""
        wanted = self._present.steps[self._step]
        if self._load is not None and np.array_equal(wanted, self._load):
            self._settle()
            return
        rising = self._load is not None and np.linalg.norm(wanted[:3]) >= np.linalg.norm(self._load[:3])
        self._request_load(wanted, RunState.LOADING, Phase.LOADING if rising else Phase.UNLOADING)

    def _request_load(self, wrench: Float1D, state: RunState, phase: Phase) -> None:
        self._wait(state)
        self._load, self._wanted = None, np.array(wrench)
        place = (self._present.number, self._number)
        self._out.append(m.RequestLoad(self._new(), *place, self._wanted, unknown=not self._at_item))
        self._mark(phase)  # whoever hears of it may confirm the load at once

    def _settle(self) -> None:
        self._mark(Phase.SETTLING)
        self._wait(RunState.SETTLING, self._rules.settling_limit)
        self._out.append(m.AwaitSettled(self._new(), self._present.number, self._number))

    def _read(self) -> None:
        self._mark(Phase.MEASURING)
        self._wait(RunState.READING, self._rules.reading_limit)
        self._readings.add(self._new())
        item, wrench = self._present, self._present.steps[self._step]
        self.queue.reading_asked(item)
        self._out.append(m.TakeReading(self._request, item.number, self._number, self._attempt, item.q, wrench))

    def _confirmed(self) -> None:
        self._readings.clear()
        self._note_reading(ReadingVerdict.KEPT)
        self._kept += 1
        self._tries, self._step = 0, self._step + 1
        self._advance()

    def _failed(self, reason: str, *, moved: bool = False) -> None:
        """Try the reading again, or give the attempt up."""
        self._tries += 1
        self._note_reading(ReadingVerdict.REPEATED, reason)
        self._say(Kind.READING_REJECTED, reason)
        self._granted += moved  # whoever did that is not the configuration's failure
        if moved or self._tries >= self._rules.readings:
            self._give_up(reason)
        elif self.paused:
            self._advance()
        else:
            self._settle()

    def _give_up(self, reason: str) -> None:
        self._readings.clear()
        self._given_up_for = reason
        self._advance()

    def _unloaded(self) -> None:
        self._at_item = False
        if self._given_up_for:
            self._retry_or_skip(self._given_up_for)
            return
        self._mark(Phase.DONE)
        self.queue.done(self._present)
        self._end_attempt(completed=True)
        if self._present.kind == "configuration":
            self._say(Kind.CONFIGURATION_DONE, "")
        self._item = None
        self._advance()

    def _retry_or_skip(self, reason: str) -> None:
        item = self._present
        self._given_up_for = ""
        self._note_reading(ReadingVerdict.GIVEN_UP, reason)
        self._end_attempt(completed=False, reason=reason)
        self._attempt, self._step, self._tries = self._attempt + 1, 0, 0
        if self._attempt < self._rules.attempts + self._granted:
            self._say(Kind.CONFIGURATION_RETRIED, reason)
            self._item = self.queue.again(item)
        else:
            self._say(Kind.CONFIGURATION_SKIPPED, reason)
            if (spare := self.queue.give_up(item)) is not None:
                self._out.append(m.Record(Kind.SPARE_USED, spare.number, 0, f"in place of {item.number}"))
            self._item = None
        self._advance()

    def _end_attempt(self, *, completed: bool, reason: str = "") -> None:
        if self._open:
            self._open = False
            self._out.append(m.EndAttempt(self._present.number, self._attempt, completed, reason))

    def _complete(self) -> None:
        done, target = len(self.queue.completed), self.queue.target
        text = f"{done} of {target} configurations are measured"
        self._say(Kind.FINISHED, text)
        self._wait(RunState.FINISHED)
        self._out.append(m.Finish(Outcome.COMPLETED if done >= target else Outcome.INCOMPLETE, text))

    def _end(self, outcome: Outcome, text: str) -> None:
        if self._state is RunState.MOVING:
            self._out.append(m.StopMotion(text))
        self._say(Kind.STOP_COMMANDED if outcome is Outcome.STOPPED else Kind.ABORTED, text)
        self._end_attempt(completed=False, reason=text)
        if self._may_be_loaded:
            self._out.append(m.AskOperator("the load may still be on: release it before the robot moves"))
        self._wait(RunState.FINISHED)
        self._out.append(m.Finish(outcome, text))

    @property
    def _may_be_loaded(self) -> bool:
        return self._load is None or bool(np.any(self._load))

    @property
    def _present(self) -> Item:
        assert self._item is not None  # noqa: S101 - there is one in every state that asks
        return self._item

    @property
    def _number(self) -> int:
        return self._present.first_step + max(min(self._step, len(self._present.steps) - 1), 0)

    def _new(self) -> int:
        self._request += 1
        return self._request

    def _wait(self, state: RunState, limit: float = math.inf) -> None:
        self._state, self._deadline = state, self._now + limit

    def _mark(self, phase: Phase) -> None:
        if (place := (self._present.number, self._number, phase)) != self._phase:
            self._phase = place
            self._out.append(m.Mark(*place))

    def _note_reading(self, verdict: ReadingVerdict, reason: str = "") -> None:
        self._reading = LastReading(verdict, self._present.number, self._number, reason)

    def _say(self, kind: Kind, text: str) -> None:
        number, step = (0, 0) if self._item is None else (self._item.number, self._number)
        self._out.append(m.Record(kind, number, step, text))
