"""`guard`: says whether the robot may be moved, as a process of its own.

It listens to the controller's state (through an adapter) and to joint states, hands them to the pure rule with the time
of the steady clock, and publishes the permission: at a fixed rate, and at every change at once.  Absence of that pulse
means no.  It stops the robot itself when the sequencer may not be able to.  It is no safety function.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from calibration_interfaces.msg import Outcome, Permission
from calibration_interfaces.srv import ConfirmMode, ProveStop, ResetGuard
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from calibration.asks import Server
from calibration.conversions import JointReader, to_outcome, to_permission, to_robot_state, to_stamp
from calibration.guard.emergency import Emergency
from calibration.guard.joint_publishers import JointPublishers
from calibration.guard.latch import Latch, latch_file
from calibration.guard.parameters import PARAMETERS, configured_adapter, guard_rules
from calibration.motion.arrival import ArrivalRules, Joints
from calibration.motion.stop import make_stop_path
from calibration.node import CalibrationNode, run
from calibration.process_tree import STANDSTILL
from calibration.rclpy_gaps import Once, Waiting
from calibration.robot_state.adapter import Confirmation, Received, Report, assemble, checked, confirmed
from calibration.topics import PERMISSION, ROBOT_STATE, load_type, several_publishers
from calibration_core.cell import load_cell
from calibration_core.errors import InputError
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.robot import chain_of
from calibration_core.motion.clock_watch import ClockWatch
from calibration_core.motion.guard import Guard, GuardDecision
from calibration_core.motion.motion_watch import AGAIN, SILENT
from calibration_core.motion.robot_status import Reason
from calibration_core.motion.speed import Monitored
from calibration_core.timeseries import NANOSECONDS

PULSE_DEADLINE = 0.1  # s, offered: two pulses of the permission are never farther apart
STATE_PERIOD = 0.5  # s, of the robot state between changes
ASK_EVERY = 1.0  # s, services of an adapter
LOOK_AROUND = 1.0  # s, who publishes what the guard rests on
RUNS_ON = "the robot does not stand: press the emergency stop"
UNSEEN = 1.0  # s, that joint states are awaited where there are too few of them to tell whether the robot stands
OTHERS = 2.0  # s, that the guard waits for the sequencer to end when both are told to


class GuardNode(CalibrationNode):
    """The node around the pure rule."""

    OWNER = "guard"

    def __init__(self, **kwargs: Any) -> None:
        """Make the node; it watches from now on.

        Raises:
            InputError: A parameter or the cell file cannot be used, or a message package is not installed.
        """
        super().__init__("guard", PARAMETERS, **kwargs)

    def on_start(self) -> None:
        """Read the cell, choose adapter and stop path, and watch; what was latched before stays latched."""
        self.cell = load_cell(self.value("cell"))
        self.monitored = Monitored.of(chain_of(self.cell), nominal_parameters(self.cell), tool_point(self.cell))
        self.adapter = configured_adapter(self)
        simulated = self.get_parameter("use_sim_time").value
        self.rules = dataclasses.replace(guard_rules(self, self.cell, self.adapter), stamps_run=not simulated)
        self._joints = Joints(ArrivalRules())
        self.stop_path = make_stop_path(
            self.value("motion.backend"),
            self,
            self.cell.robot.joints,
            interface=self.value("motion.interface"),
            course=lambda: self._joints.course(self.now_ns()),
            ended=self._on_goal_ended,
        )
        self._asked: dict[str, tuple[Server, Any]] = {}  # services and their classes
        self._deciding = threading.RLock()
        self._emergency = Emergency(self, self.stop_path, self.value("sequencer_age"), self.value("trace"))
        self._latch = Latch(latch_file(self.cell, self.get_namespace()))
        self._latched = self._latch.reasons
        self.guard = Guard(self.monitored, self.rules, self.stop_path.how, latched=self._latched)
        self._proving = b""  # the goal that is to be stopped for a proof
        self._deaf = False  # the driver has not acknowledged a stop
        self._received: dict[str, Received] = {}
        self._report = Report(self.adapter.translate({}))
        self._confirmation: Confirmation | None = None
        self._joint_publishers = JointPublishers(self.monitored.chain.joints)
        self._last: GuardDecision | None = None
        self._state_sent = -math.inf
        self._clock_watch = ClockWatch(self.value("clock_jump"))
        self._speak()
        self._listen()

    def _speak(self) -> None:
        pulse = PERMISSION.qos
        pulse.deadline = Duration(nanoseconds=round(PULSE_DEADLINE * NANOSECONDS))
        self._permission = self.create_publisher(PERMISSION.message, PERMISSION.relative, pulse)
        self._state = self.create_publisher(ROBOT_STATE.message, ROBOT_STATE.relative, ROBOT_STATE.qos)
        self.create_service(ResetGuard, "~/reset", self._on_reset)
        self.create_service(ConfirmMode, "~/confirm_mode", self._on_confirm)
        self.create_service(ProveStop, "~/prove_stop", self._on_prove, callback_group=ReentrantCallbackGroup())
        for key, source in self.adapter.sources.items():
            if source.is_service:
                kind = load_type(source.kind)
                self._asked[key] = (Server(self, kind, source.name), kind)

    def _listen(self) -> None:
        # Best effort is heard from every publisher, and of a state only the newest matters.
        newest = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
        kept = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        joint_states = self.cell.topics.joint_states.lstrip("/")
        self._joint_states = Waiting(self, JointState, joint_states, newest, raw=True)
        self._reader = JointReader(self.monitored.chain.joints)
        for key, source in self.adapter.sources.items():
            if not source.is_service:
                quality = newest if source.max_age is not None else kept
                self.create_subscription(
                    load_type(source.kind), source.name, functools.partial(self._take, key), quality
                )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self.value("rate"), self._on_pulse, clock=steady)
        self.create_timer(LOOK_AROUND, self._look_around, clock=steady)
        if self._asked:
            self.create_timer(ASK_EVERY, self._ask, clock=steady)

    # --- what arrives ------------------------------------------------------------------------------------------------

    def _take(self, key: str, message: Any) -> None:
        self._received[key] = Received(message, time.monotonic_ns())
        now, before = time.monotonic(), self._report.status
        self._note(now)
        if self._report.status != before:
            self._decide(now)

    def _note(self, now: float) -> None:
        """Hand the state as it is known over, once every topic that is awaited has been heard."""
        self._report = report = self._known(now)
        if report.received_time and (self.adapter.awaited or self._confirmation is not None):
            self.guard.on_status(report.status, report.received_time / NANOSECONDS, report.max_age, report.first)

    def _known(self, now: float) -> Report:
        report = assemble(self.adapter, self._received, round(now * NANOSECONDS))
        if self._confirmation is not None:
            self._confirmation = self._confirmation.after(report.status, now)
        return confirmed(report, self._confirmation, now)

    def _take_joints(self) -> None:
        """Take the joint states that have come: every decision rests on all of them, and on when they arrived."""
        for payload, arrived, number in self._joint_states.arrivals():
            sample = self._reader.read(payload)
            if self._joint_publishers.hear(self._reader.names, number, arrived):
                self.guard.on_new_source()
            if sample is None:  # another device's joints, or some of ours
                continue
            stamp, q = sample
            self._joints.add(stamp or self.now_ns(), q)
            self.guard.on_joints(q, arrived, stamp / NANOSECONDS if stamp else math.nan)

    def _ask(self) -> None:
        """Ask the adapter's services again; an answer that does not come is given up, for its server may be gone."""
        for key, (server, kind) in self._asked.items():
            server.tick(time.monotonic())
            if not server.asked and server.ready():
                server.ask(kind.Request(), functools.partial(self._on_answer, key), 3.0 * ASK_EVERY)

    def _on_answer(self, key: str, answer: Any, _text: str) -> None:
        if answer is not None:
            self._take(key, answer)

    # --- what is said ------------------------------------------------------------------------------------------------

    def _on_pulse(self) -> None:
        self.health.look()
        self._emergency.take()
        now = time.monotonic()
        if self._clock_watch.jumped(self.now_ns(), now):
            self.guard.on_clock_jump()
        self._note(now)  # a source may have fallen silent, or a confirmation ended
        if self._emergency.another(now):
            self._look_around()
        self._decide(now)
        if self._last is None:
            return
        if self.guard.prove(self._last):
            self._emergency.command(now, "proof of the stop")
        if self._emergency.look(now, permitted=self._last.permitted, speed=self._last.speed) == SILENT:
            self.guard.on_silence()
            self._decide(now)
        deaf = self.stop_path.unanswered(now)
        if deaf and not self._deaf:
            self.guard.proof.void("the driver did not acknowledge a stop")
        self._deaf = deaf

    def _on_goal_ended(self, goal: bytes, cancelled: bool) -> None:
        if goal == self._proving:
            self._proving = b""
            self.guard.proof.on_ended(time.monotonic(), cancelled=cancelled)

    def _look_around(self) -> None:
        """See who publishes what the guard rests on: of two, nobody knows which one speaks of the robot."""
        topics = [source.name for source in self.adapter.sources.values() if not source.is_service]
        found = [several_publishers(self, topic) for topic in topics]
        joints, twice = self.cell.topics.joint_states, self._joint_publishers.twice(time.monotonic())
        named = several_publishers(self, joints.lstrip("/"))
        if twice:
            found.append(f"{', '.join(twice)}: {named or joints}")
        elif not self._joint_publishers.numbered:
            found.append(named)
        found.append(self._emergency.others(time.monotonic()))
        self.guard.on_sources("; ".join(filter(None, found)))

    def on_second(self, words: str, younger: bool) -> None:
        """Another guard is heard: neither permits anything."""
        self.guard.on_second_guard()
        self._decide(time.monotonic())
        super().on_second(words, younger)

    def _decide(self, now: float) -> None:
        with self._deciding:
            self._take_joints()
            self._publish(self.guard.decide(now), now)

    def _message(self, decision: GuardDecision, stamp: int, now: float) -> Permission:
        hears, stop = self._emergency.hears(now), self.stop_path.text
        return to_permission(decision, self.rules, stamp, hears=hears, stop=stop)

    def _publish(self, decision: GuardDecision, now: float) -> None:
        stamp = self.now_ns()
        self._permission.publish(self._message(decision, stamp, now))
        before, self._last = self._last, decision
        self._keep(decision.latched)
        changed = before is None or (before.permitted, before.reasons, before.latched) != (
            decision.permitted, decision.reasons, decision.latched,
        )  # fmt: skip
        if changed or now - self._state_sent >= STATE_PERIOD:
            self._state_sent = now
            steady_to_ros = stamp - round(now * NANOSECONDS)
            self._state.publish(to_robot_state(self._report, stamp, steady_to_ros=steady_to_ros))
        if changed:
            self.diagnostics.report("permission", 0 if decision.permitted else 1, decision.text)
            if before is not None and before.permitted and not decision.permitted:
                self.get_logger().warning(f"motion is no longer permitted: {decision.text}")
            else:
                self.get_logger().info(decision.text)

    def _keep(self, latched: tuple[Reason, ...]) -> None:
        """Keep what is latched for the guard after this one; that this one is told to end is no fault."""
        if latched == self._latched or self.ending.is_set():
            return
        self._latched = latched
        try:
            self._latch.keep(latched)
        except OSError as error:
            text = f"{self._latch.path}: {error}: a guard that is started again will not be latched"
            self.get_logger().error(text)
            self.diagnostics.report("latch", 2, text)

    # --- what the operator says --------------------------------------------------------------------------------------

    def _on_reset(self, request: Any, response: Any) -> Any:
        with self._deciding:
            self._take_joints()
            now = time.monotonic()
            decision = self.guard.decide(now) if not request.operator_name.strip() else self.guard.reset(now)
            self._publish(decision, now)
        response.permission = self._message(decision, self.now_ns(), now)
        if not request.operator_name.strip():
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, "the name of who answers for it is missing")
        elif decision.latched:
            response.outcome = to_outcome(Outcome.NOT_PERMITTED, decision.text)
        else:
            self.get_logger().info(f"reset by {request.operator_name.strip()}")
            response.outcome = to_outcome(Outcome.OK, decision.text)
        return response

    def _on_confirm(self, request: Any, response: Any) -> Any:
        now = time.monotonic()
        reported = assemble(self.adapter, self._received, round(now * NANOSECONDS)).status.operating_mode
        asked = (request.operator_name, request.operating_mode, request.valid_for)
        try:
            self._confirmation = checked(*asked, reported, now)
        except InputError as error:
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, str(error))
            return response
        self._note(now)
        self._decide(now)
        valid_for = self._confirmation.until - now
        response.confirmed_until = to_stamp(self.now_ns() + round(valid_for * NANOSECONDS))
        text = f"{self._confirmation.operator} confirms {self._confirmation.mode.name} for {valid_for:.0f} s"
        self.get_logger().info(text)
        response.outcome = to_outcome(Outcome.OK, text)
        return response

    # --- the proof that the robot can be stopped ---------------------------------------------------------------------

    async def _on_prove(self, request: Any, response: Any) -> Any:
        proof, now = self.guard.proof, time.monotonic()
        if proof.running:
            response.outcome = to_outcome(Outcome.BUSY, "a proof is under way")
            return response
        self._proving = bytes(request.goal)
        proof.begin(now)
        await Once(lambda: not proof.running)
        self._decide(time.monotonic())
        if proof.proven:
            response.outcome = to_outcome(Outcome.OK, f"seen: {self.stop_path.text}")
        else:
            response.outcome = to_outcome(Outcome.TEST_FAILED, proof.text)
        self.get_logger().info(f"proof of the stop: {response.outcome.text}")
        return response

    # --- the end -----------------------------------------------------------------------------------------------------

    def on_end(self) -> None:
        """Take the permission back, stop what moves, and go when the robot stands: last of all."""
        began = time.monotonic()
        with self._deciding:  # the executor's thread still decides
            self.guard.stop()
            self._decide(began)
        moved, stopped = self._emergency.moving, -math.inf
        while (now := time.monotonic()) < began + STANDSTILL:
            standing = self._joints.latest is None or self._joints.standing()
            moved |= self._joints.moving()
            if moved and (not standing or stopped == -math.inf) and now - stopped > AGAIN:
                stopped = now
                self._emergency.command(now, "the guard is being shut down")
            at_rest = standing or now - began > UNSEEN
            stands = standing and now - began > ArrivalRules().dwell and not self.stop_path.waiting
            if (stands if moved else at_rest) and (not self._emergency.hears(now) or now - began > OTHERS):
                return
            time.sleep(0.02)
        self.get_logger().error(RUNS_ON)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(GuardNode, args)


if __name__ == "__main__":
    sys.exit(main())
