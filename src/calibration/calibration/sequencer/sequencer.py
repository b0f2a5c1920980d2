"""`sequencer`: measures a plan in the cell.

The action `~/run` starts a thread that runs the pure procedure; callbacks only put what they hear into its queue.  The
robot is moved only while the guard says yes, and has been seen to be able to stop it; whatever takes that away stops
the motion at once, and nothing moves again before the operator resumes motion by name.
"""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections.abc import Callable
from collections.abc import Sequence as Arguments
from pathlib import Path
from typing import Any

from calibration_interfaces.action import ApplyLoad, RunPlan
from calibration_interfaces.msg import MeasurementStep, MotionPulse, Outcome, Permission, SessionEvent
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from calibration.asks import Server, callers, succeeded
from calibration.cell.clients import Instruments
from calibration.cell.conditions_watch import HEARD, ConditionsWatch
from calibration.cell.equipment import Equipment, Recorder, Wanted
from calibration.cell.port import CellPort
from calibration.cell.reading_checks import ReadingChecks
from calibration.cell.watches import DescriptionWatch, PermissionWatch, WrenchWatch
from calibration.conversions import JointReader, stamp_ns, to_outcome
from calibration.evaluation.markers import to_markers
from calibration.guard.guard import PULSE_DEADLINE
from calibration.motion.arrival import Joints
from calibration.motion.backends import make_backend
from calibration.motion.prover import Prover
from calibration.motion.stop import Stopper
from calibration.node import CalibrationNode, run
from calibration.rclpy_gaps import Waiting
from calibration.sequencer.feedback import Feedback
from calibration.sequencer.goal import ClientWatch, Goal, Request, RunAction, Stage
from calibration.sequencer.operator_services import OperatorServices
from calibration.sequencer.parameters import DEVICE, PARAMETERS, arrival_rules, motion_limits, sequence_rules
from calibration.sequencer.provenance import provenance
from calibration.sequencer.runner import Call, Runner
from calibration.topics import (
    EVENT,
    MOTION_PULSE,
    PERMISSION,
    PLAN_MARKERS,
    READING,
    Quality,
    profile,
)
from calibration_core.cell import load_cell
from calibration_core.measurement import messages as m
from calibration_core.measurement.sequence import Sequence
from calibration_core.measurement.session import Session
from calibration_core.measurement.unloaded import LoadMemory, memory_file
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import Monitored
from calibration_core.outcomes.spaces import planned_space
from calibration_core.planning.plans.plan import Plan
from calibration_core.planning.plans.plan_file import read_plan
from calibration_core.recording.definitions.own import TRACKER_CLOCK
from calibration_core.recording.session_values import Decision, Event
from calibration_core.report.results.scene import scene_of, space_dict
from calibration_core.timeseries import NANOSECONDS, Float1D

PULSE = 0.02  # s of wall time between two signs of life
ALONE_PULSE = 0.022  # s, likewise, while the guard is silent: with its word, one wake of the executor does for both
APPLY_LOAD = "driver/apply_load"  # action of the load device
BAG = "bag"  # in the session's directory
END_TIME = 1.6  # s of wall time, a run has to end when the process does
ALONE = 1.0  # s, since another sequencer was heard
OUTCOMES = {
    m.Outcome.COMPLETED: Outcome.OK,
    m.Outcome.INCOMPLETE: Outcome.BLOCKED,
    m.Outcome.STOPPED: Outcome.STOPPED,
    m.Outcome.FAULT: Outcome.FAULT,
}
AT_LEAST = 0.3  # s, that everything is looked for, however long the search for what came before took


class SequencerNode(CalibrationNode):
    """The node around the pure procedure.

    Attributes:
        cell: The cell.
        steps: Publisher of step markers; likewise `events` and `readings`.
        stopper: Stops the robot.
        watch: The guard's word.
        runner: Runs the procedure; None while no plan is being measured, and likewise `port`.
        conditions: Judges the conditions of the standard.
        joints: The joint states.
        instruments: Tracker and force/torque sensor; `load_device` is None where an operator changes the load.
        equipment: What else a measurement needs.
    """

    OWNER = "sequencer"

    def __init__(self, **kwargs: Any) -> None:
        """Make the node.

        Raises:
            InputError: A parameter or the cell file cannot be used, or a message package is not installed.
        """
        super().__init__("sequencer", PARAMETERS, **kwargs)

    def on_start(self) -> None:
        """Connect to the cell and listen; nothing moves before somebody asks for a measurement."""
        self.cell = load_cell(self.value("cell"), live=True)
        self.monitored = Monitored.of(chain_of(self.cell), nominal_parameters(self.cell), tool_point(self.cell))
        self.runner: Runner | None = None
        self.port: CellPort | None = None
        self._counted, self._beaten = itertools.count(), -math.inf  # signs of life; the last, s of the steady clock
        self._decided: tuple[Any, ...] = ()
        self._lost = ""  # of recorder and instruments, when a motion was looked at last
        self._backend = make_backend(
            self.value("motion.backend"),
            self,
            self.cell.robot.joints,
            interface=self.value("motion.interface"),
            tolerance=arrival_rules(self).tolerance,
            course=self._course,
            ask=lambda text: self.diagnostics.report("operator", 1, text),
        )
        self._prover = Prover(self, self._backend, self.cell.robot.joints, self._course)
        self._second = (-math.inf, "")  # when another sequencer was heard, s of the steady clock, and words about it
        self._prepare = callers(self, "motion.prepare_services")
        self.stopper = Stopper(
            self,
            self._backend,
            self.cell.robot.joints,
            self._course,
            hold_topic=self.value("motion.hold_topic"),
            calls=callers(self, "motion.stop_services"),
            trace=self.value("trace"),
        )
        by_device = self.value("load.by") == DEVICE
        self.load_device = Server(self, ApplyLoad, APPLY_LOAD) if by_device else None
        self.instruments = Instruments(self, self.value("tracker"), self.value("force_torque"))
        self.servers = [*self.instruments.servers.values(), *([self.load_device] if self.load_device else [])]
        self.conditions = ConditionsWatch(self)
        self.feedback = Feedback(self, advise=self.value("progress"))
        self._speak()
        self.joints = Joints(arrival_rules(self), keep=60.0 + self.value("reading_limit"))
        self.watch = PermissionWatch(self.value("permission_age"))
        self._wrench = WrenchWatch(self) if self.value("force_torque") else None
        self._listen()

    def _speak(self) -> None:
        step = self.cell.topics.step.lstrip("/")
        self.steps = self.create_publisher(MeasurementStep, step, profile(Quality.EVENTS))
        self.events = self.create_publisher(EVENT.message, EVENT.relative, EVENT.qos)
        self.readings = self.create_publisher(READING.message, READING.relative, READING.qos)
        self._markers = self.create_publisher(PLAN_MARKERS.message, PLAN_MARKERS.relative, PLAN_MARKERS.qos)
        self._pulse = self.create_publisher(MOTION_PULSE.message, MOTION_PULSE.relative, MOTION_PULSE.qos)
        OperatorServices(self)
        self._client = ClientWatch(self)
        self.runs = RunAction(self, self._measure, self._against, self._stop_motion)
        self._recorder = Recorder(self, self.value("recorder"), self.value("recorder_age"))
        self._description = DescriptionWatch(self)
        self.equipment = Equipment(self, self._recorder, self._description, self.value("instrument_age"))

    def _listen(self) -> None:
        newest = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
        joint_states = self.cell.topics.joint_states.lstrip("/")
        self._joint_states = Waiting(self, JointState, joint_states, newest, raw=True)
        self._reader = JointReader(self.cell.robot.joints)
        pulse = PERMISSION.qos
        pulse.deadline = Duration(nanoseconds=round(PULSE_DEADLINE * NANOSECONDS))
        silence = SubscriptionEventCallbacks(deadline=lambda _: self._on_silence())
        self.create_subscription(Permission, PERMISSION.relative, self._on_permission, pulse, event_callbacks=silence)
        self._timer = self.create_timer(ALONE_PULSE, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))
        quality = QoSProfile(depth=100)  # what was said before belongs to no run of ours
        self.create_subscription(SessionEvent, EVENT.relative, self._on_event, quality)

    def _course(self) -> tuple[Float1D, Float1D, float] | None:
        return self.joints.course(self.now_ns())

    # --- what arrives ------------------------------------------------------------------------------------------------

    def _take_streams(self) -> None:
        for payload in self._joint_states.take():
            sample = self._reader.read(payload)
            if sample is not None:
                self.joints.add(sample[0] or self.now_ns(), sample[1])
        self.conditions.take()
        self.equipment.take()
        self.health.look()
        if self._wrench is not None:
            self._wrench.take()

    def _on_permission(self, message: Permission) -> None:
        self.watch.hear(message, time.monotonic())
        if not message.permitted:
            self._halt(str(message.text))
        decided = (bool(message.permitted), bool(message.latched), tuple(message.reasons))
        if decided != self._decided:
            self._decided = decided
            self._store(message)
        self._beat()

    def _on_silence(self) -> None:
        permitted, text = self.watch.at(time.monotonic())
        if not permitted:
            self._halt(text)

    def _halt(self, why: str) -> None:
        """Stop a motion for what the procedure hears at its next look."""
        runner = self.runner
        if runner is not None and self._interrupt():
            runner.post(m.PermissionChanged(0.0, False, why))

    def _interrupt(self) -> bool:
        """Stop the motion under way without waiting for the runner's turn; return whether there is one to stop."""
        runner = self.runner
        if runner is None or not runner.moving or runner.stopping:
            return False
        self.stopper.take(0)
        return True

    def _stop_motion(self) -> None:
        """Stop whatever of ours moves the robot, again where it is being stopped, the proof of the stop included."""
        runner = self.runner
        if runner is not None and (runner.moving or runner.stage is Stage.PROVING):
            self.stopper.take(0)

    def _store(self, message: Permission) -> None:
        runner, port = self.runner, self.port
        if runner is None or port is None:
            return
        reasons = tuple(filter(None, str(message.text).split("; "))) if not message.permitted else ()
        decision = Decision(stamp_ns(message.header.stamp), message.permitted, message.latched, reasons)
        runner.post(Call(lambda: port.keep(lambda: port.session.decide(decision))))

    def _on_event(self, message: SessionEvent) -> None:
        """Write down, in the session under way, what an operator asked for at a panel, and the tracker's clock."""
        runner, port = self.runner, self.port
        kind = {SessionEvent.OPERATOR_ACTION: "operator_action", TRACKER_CLOCK: "tracker_clock"}.get(message.kind)
        if kind is not None and runner is not None and port is not None:
            event = Event(self.now_ns(), kind, f"{message.source}: {message.text}")
            runner.post(Call(lambda: port.keep(lambda: port.session.note(event))))

    def _on_timer(self) -> None:
        self._on_silence()  # its event may come but once, and the runner may be waiting for a disk
        self._beat()

    def _beat(self) -> None:
        """Take what has come, and give a sign of life, where one is due."""
        now = time.monotonic()
        if now - self._beaten < 0.9 * PULSE:
            return
        self._beaten = now
        self._timer.reset()
        self._take_streams()
        runner = self.runner
        moving = runner is not None and runner.moving
        lost = self.equipment.fault(now) if moving else ""
        if runner is not None and lost and not self._lost and self._interrupt():
            runner.post(Call(lambda: runner.lose(lost)))
        self._lost = lost
        self._pulse.publish(MotionPulse(identity=self.health.identifier, count=next(self._counted), moving=moving))

    # --- what others want ---------------------------------------------------------------------------------------------

    def on_second(self, words: str, younger: bool) -> None:
        """Another sequencer is heard: neither moves the robot."""
        self._second = (time.monotonic(), words)
        self._halt(words)
        if self.runner is not None:
            self.runner.post(m.PermissionChanged(0.0, False, words))
        super().on_second(words, younger)

    def _against(self) -> str:
        heard, words = self._second
        return words if time.monotonic() - heard < ALONE else self._description.fault

    # --- a run -------------------------------------------------------------------------------------------------------

    def _measure(self, goal: Goal) -> Any:
        """Measure a plan from beginning to end; runs in a thread of its own.

        Raises:
            GoalEndedError: The goal was asked to end before the run began.
        """
        try:
            return self._run(goal)
        finally:
            goal.end()
            for server in self.servers:
                server.drop()
            self._recorder.close()

    def _run(self, goal: Goal) -> Any:
        request = goal.handle.request
        self._rules, self._limits = sequence_rules(self), motion_limits(self, self.cell)  # as they are set now
        plan = read_plan(request.plan, self.cell)
        self._markers.publish(to_markers(self.cell, scene_of(space_dict(planned_space(plan, self.cell)), scale=1.0)))
        directory = Path(request.session)
        text = Path(request.plan).read_text(encoding="utf-8")
        goal.enter(Stage.NODES)
        absent = self._missing(goal)
        if absent:
            return RunPlan.Result(outcome=to_outcome(Outcome.NO_DATA, absent))
        different = self._description.judged()
        if different:
            return RunPlan.Result(outcome=to_outcome(Outcome.INPUT_UNUSABLE, different))
        goal.enter(Stage.GUARD)
        goal.until(lambda: self.watch.ready(time.monotonic()) or self.watch.latched, self.value("server_wait"))
        held = not self.watch.ready(time.monotonic())  # a latched fault does not go by itself
        wrong = self.conditions.begin(plan, self._limits.allowed, self._rules.startup_period, request.overrides)
        if wrong:
            return RunPlan.Result(outcome=to_outcome(Outcome.INPUT_UNUSABLE, wrong))
        violated = "" if request.resume else self.conditions.violated()
        if violated:  # before there is a session that would have to be resumed
            return RunPlan.Result(outcome=to_outcome(Outcome.CONDITION_VIOLATED, violated))
        goal.enter(Stage.SESSION)
        open_session = Session.resume if request.resume else Session.create
        with open_session(directory, text, self.cell) as session:
            parameters = {name: self.value(name) for name in sorted(self._table)}
            self.conditions.opened(session)
            violated = self.conditions.violated()
            if violated:
                return RunPlan.Result(outcome=to_outcome(Outcome.CONDITION_VIOLATED, violated))
            session.begin_run(self.now_ns(), provenance(self.cell, text, parameters))
            goal.enter(Stage.RECORDER)
            bag = Wanted(directory.absolute() / BAG, session.plan_sha256, self.now_ns(), session.identity)
            lost = self._recorder.record(bag, goal.until)
            if lost:
                return RunPlan.Result(outcome=to_outcome(Outcome.NO_DATA, lost), session=str(directory))
            runner, port = self._start(goal, plan, session)
            self.feedback.begin(goal.handle, runner)
            self._client.begin(time.monotonic())
            finish = runner.run(held=held)
            port.write()
            done, skipped = len(runner.sequence.queue.completed), len(runner.sequence.queue.given_up)
        goal.end()
        self._recorder.close()
        recorded, lost = self._recorder.recorded(directory, BAG)
        how = (Outcome.FAULT, f"{lost}; {finish.text}") if lost else (OUTCOMES[finish.outcome], finish.text)
        return RunPlan.Result(
            outcome=to_outcome(*how),
            session=str(directory),
            recording=str(recorded),
            configurations_done=done,
            configurations_skipped=skipped,
            readings=port.confirmed,
        )

    def _start(self, goal: Goal, plan: Plan, session: Session) -> tuple[Runner, CellPort]:
        memory = LoadMemory(memory_file(self.cell, self.get_namespace(), self.value("load.memory")))
        given_up = session.given_up(self._rules.attempts)
        sequence = Sequence(
            plan,
            self._rules,
            completed=frozenset(session.completed),
            given_up=given_up,
            visits=session.reference_visits,
            by_device=self.load_device is not None,
            loaded=self.load_device is not None or memory.left != "",
        )
        checks = ReadingChecks(self.cell, plan, self.joints, self._wrench, memory, self.now_ns)
        self.port = port = CellPort(self, session, checks)
        self.runner = runner = Runner(
            goal,
            sequence,
            port,
            self._backend,
            self.joints,
            self.watch,
            self.monitored,
            self._limits,
            self._prover,
            self.stopper,
            settle_time=self.value("settle_time"),
        )
        self._decided = ()  # what the guard says next is stored
        goal.begin(runner)
        return runner, port

    def _missing(self, goal: Goal) -> str:
        """Look for everything that a run needs, before anything moves; return all that is not there."""
        wait = self.value("server_wait")
        end = time.monotonic() + wait
        topic = self.cell.topics.joint_states
        checks: list[Callable[[], str]] = [
            self._backend.missing,
            *(server.missing for server in self.servers),
            lambda: "" if self.joints.latest is not None else f"no joint states on {topic}",
        ]
        absent = [self._prepared(goal, wait)]
        goal.until(lambda: not any(check() for check in checks), left(end))
        absent += [check() for check in checks]
        goal.until(self.conditions.thermometer_heard, min(left(end), HEARD))
        return "; ".join(filter(None, [*absent, self._recorder.missing(left(end), goal.until)]))

    def _prepared(self, goal: Goal, wait: float) -> str:
        """Call the driver's services in their order, up to the first that fails; return why it did."""
        for server, request in self._prepare:
            answer = server.call(request, wait, goal.until)
            success, text = (False, "no answer") if answer is None else succeeded(answer)
            if not success:
                return f"{server.name}: {text or 'refused'}"
        return ""

    def progress(self) -> None:
        """Judge the conditions and tell how far a run is, now and then; in the runner's thread."""
        runner, port = self.runner, self.port
        if runner is not None and port is not None:
            self.conditions.look(port, runner)
            self.feedback.send()
            if self._client.vanished(time.monotonic()):
                runner.pause("nobody takes the feedback of the run any more: resume when somebody minds it")

    def busy(self) -> str:
        """Say that a plan is being measured: what it is measured with does not change meanwhile."""
        return self.runs.take(Request.GOAL).refusal

    def on_end(self) -> None:
        """End the run (the motion is stopped, the session closed), and the process that works progress out."""
        self.runs.take(Request.END)
        if not self.runs.wait(END_TIME):
            self.get_logger().error(f"the run has not ended within {END_TIME:g} s")
        self.feedback.close()


def left(end: float) -> float:
    """Return how long something may still be looked for until `end`, s of the steady clock."""
    return max(end - time.monotonic(), AT_LEAST)


def main(args: Arguments[str] | None = None) -> int:
    """Run the node."""
    return run(SequencerNode, args)


if __name__ == "__main__":
    sys.exit(main())
