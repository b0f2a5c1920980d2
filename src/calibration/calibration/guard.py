"""`guard`: says whether the robot may be moved, as a process of its own.

It listens to the controller's state (through an adapter) and to joint states, hands them to the pure rule with the time
of the steady clock, and publishes the permission: at a fixed rate, and at every change at once.  Absence of that pulse
means no.  It stops the robot itself when the sequencer may not be able to.  It is no safety function.
"""

from __future__ import annotations

import dataclasses
import math
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import ConfirmMode, ResetGuard
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from calibration.conversions import joint_positions, stamp_ns, to_outcome, to_stamp
from calibration.emergency import Emergency
from calibration.guard_messages import mode_names, to_evidence, to_permission, to_robot_state
from calibration.motion.catalogue import MOTION_INTERFACE
from calibration.motion.stop_path import make_stop_path
from calibration.node import CalibrationNode, Declared, run
from calibration.robot_state import generic
from calibration.robot_state.adapter import Adapter, Received, Report, Source, assemble
from calibration.robot_state.catalogue import GENERIC, NAMES, adapter_of, load_type
from calibration.robot_state.confirmation import Confirmation, checked, confirmed
from calibration.topics import GUARD_EVIDENCE, PERMISSION, ROBOT_STATE
from calibration_core.cell import load_cell
from calibration_core.errors import InputError, quoted
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.procedure.guard import Decision, Guard, GuardRules
from calibration_core.procedure.robot_status import OperatingMode
from calibration_core.procedure.speed import Monitored
from calibration_core.timeseries import NANOSECONDS

PULSE_DEADLINE = 0.1  # s, offered: two pulses of the permission are never farther apart
LONGEST_AGE = 10.0  # s, of a source's last message
ASK_EVERY = 1.0  # s, services of an adapter
RULES = GuardRules()
MODES = tuple(mode.name for mode in OperatingMode if mode is not OperatingMode.UNKNOWN)

PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("rate", 50.0, "Hz, of the permission.", low=20.0, high=500.0),
    Declared("evidence_rate", 2.0, "Hz, of the evidence between changes.", low=0.1, high=50.0),
    Declared("allowed_modes", ["MANUAL_REDUCED"], f"Operating modes in which motion is permitted: {', '.join(MODES)}."),
    Declared("speed_limit", RULES.speed_limit, "m/s, of every monitored point.", low=0.01, high=0.25),
    Declared("tolerance", RULES.tolerance, "Share by which a measured speed may exceed the limit.", low=0.0, high=0.2),
    Declared("max_state_age", RULES.max_state_age, "s, of the robot state.", low=0.05, high=10.0),
    Declared("max_joints_age", RULES.max_joints_age, "s, of the joint states.", low=0.01, high=1.0),
    Declared("freeze_time", RULES.freeze_time, "s, joint states repeat while in motion.", low=0.02, high=5.0),
    Declared("speed_window", RULES.speed_window, "s, over which speed is measured.", low=0.0, high=1.0),
    Declared("jump_rate", RULES.jump_rate, "rad/s, no joint is faster.", low=1.0, high=100.0),
    Declared("scaling_zero_time", RULES.scaling_zero_time, "s, speed scaling may be zero.", low=0.0, high=10.0),
    Declared("max_pause", RULES.max_pause, "s, between two decisions, and between stamps of joint states.", low=0.1),
    *MOTION_INTERFACE,
    Declared("sequencer_age", 0.1, "s, of the sequencer's sign of life while it moves the robot.", low=0.05, high=5.0),
    Declared("trace", "", "File for the monotonic clock's ns of what it stops; empty: none."),
    Declared("clock_jump", 2.0, "s, the clock may advance between two decisions.", low=0.1, high=3600.0),
    Declared("robot_state.adapter", "native", "How the controller's state is understood.", choices=NAMES),
    Declared("robot_state.topics", [], "Names of topics other than the driver's defaults, as key=name."),
    Declared("robot_state.max_ages", [], "s, that a source's last message counts, other than usual, as key=seconds."),
    Declared("robot_state.generic.topic", "", "Topic of the generic adapter."),
    Declared("robot_state.generic.type", "", "Its type, package/msg/Name."),
    Declared(
        "robot_state.generic.max_age", 1.0, "s, after which its last message counts no longer.", low=0.05, high=10.0
    ),
    *(Declared(f"robot_state.generic.{name}", "", "Rule: path = value: WORD, ...") for name in generic.WORDS),
)


class GuardNode(CalibrationNode):
    """The node around the pure rule."""

    def __init__(self, **kwargs: Any) -> None:
        """Start to watch.

        Raises:
            InputError: A parameter or the cell file cannot be used, or a message package is not installed.
        """
        super().__init__("guard", PARAMETERS, **kwargs)
        self.cell = load_cell(self.value("cell"))
        self.monitored = Monitored.of(chain_of(self.cell), nominal_parameters(self.cell))
        self.rules = self._rules()
        self.guard = Guard(self.monitored, self.rules)
        self.adapter = self._adapter()
        self._received: dict[str, Received] = {}
        self._asked: dict[str, tuple[Any, Any, float]] = {}  # service -> client, pending answer, since
        self._report = Report(self.adapter.translate({}))
        self._confirmation: Confirmation | None = None
        self._q = np.full(self.monitored.chain.n, math.nan)
        self._last: Decision | None = None
        self._deciding = threading.RLock()
        self._evidence_sent = -math.inf
        self._ros_time = 0
        self._stop_path = make_stop_path(
            self.value("motion.backend"),
            self,
            self.cell.robot.joints,
            interface=self.value("motion.interface"),
            where=lambda: self._q if np.isfinite(self._q).all() else None,
        )
        self._emergency = Emergency(self, self._stop_path, self.value("sequencer_age"), self.value("trace"))
        self._speak()
        self._listen()

    def _rules(self) -> GuardRules:
        try:
            modes = mode_names(self.value("allowed_modes"))
        except KeyError as error:
            raise InputError("guard", "allowed_modes", quoted(error.args[0]), f"some of {', '.join(MODES)}") from None
        declared = None if self.cell.safety is None else self.cell.safety.speed_limit
        names = {field.name for field in dataclasses.fields(GuardRules)} - {"allowed_modes", "declared_limit"}
        given = {name: self.value(name) for name in names if name in self._table}
        return GuardRules(allowed_modes=modes, declared_limit=declared, **given)

    def _adapter(self) -> Adapter:
        name = self.value("robot_state.adapter")
        if name == GENERIC:
            place = "robot_state.generic"
            rules = {quantity: self.value(f"{place}.{quantity}") for quantity in generic.WORDS}
            topic, kind, age = (self.value(f"{place}.{key}") for key in ("topic", "type", "max_age"))
            adapter = generic.adapter(topic, kind, age, rules)
        else:
            adapter = adapter_of(name)
        topics, ages = self._by_key(adapter, "robot_state.topics"), self._by_key(adapter, "robot_state.max_ages")
        sources = []
        for source in adapter.sources:
            age = source.max_age
            if source.key in ages:
                age = self._seconds("robot_state.max_ages", ages[source.key])
            sources.append(dataclasses.replace(source, name=topics.get(source.key, source.name), max_age=age))
        return dataclasses.replace(adapter, sources=tuple(sources))

    def _by_key(self, adapter: Adapter, name: str) -> dict[str, str]:
        known = {source.key for source in adapter.sources}
        found = {}
        for entry in self.value(name):
            key, _, text = entry.partition("=")
            if key not in known or not text:
                expected = f"key=value with a key of {', '.join(sorted(known)) or 'no topic at all'}"
                raise InputError("guard", name, quoted(entry), expected)
            found[key] = text
        return found

    def _seconds(self, name: str, text: str) -> float:
        try:
            seconds = float(text)
        except ValueError:
            seconds = math.nan
        if not 0.0 < seconds <= LONGEST_AGE:
            raise InputError("guard", name, quoted(text), f"above 0, at most {LONGEST_AGE:g} s")
        return seconds

    def _speak(self) -> None:
        pulse = PERMISSION.qos
        pulse.deadline = Duration(nanoseconds=round(PULSE_DEADLINE * NANOSECONDS))
        self._permission = self.create_publisher(PERMISSION.message, PERMISSION.relative, pulse)
        self._evidence = self.create_publisher(GUARD_EVIDENCE.message, GUARD_EVIDENCE.relative, GUARD_EVIDENCE.qos)
        self._state = self.create_publisher(ROBOT_STATE.message, ROBOT_STATE.relative, ROBOT_STATE.qos)
        self.create_service(ResetGuard, "~/reset", self._on_reset)
        self.create_service(ConfirmMode, "~/confirm_mode", self._on_confirm)

    def _listen(self) -> None:
        # Best effort is heard from every publisher, and of a state only the newest matters.
        newest = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
        kept = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(JointState, self.cell.topics.joint_states.lstrip("/"), self._on_joints, newest)
        for source in self.adapter.sources:
            kind = load_type(source.type)
            if source.is_service:
                self._asked[source.key] = (self.create_client(kind, source.name), None, -math.inf)
            else:
                quality = newest if source.max_age is not None else kept
                self.create_subscription(kind, source.name, self._hear(source), quality)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self.value("rate"), self._on_pulse, clock=steady)
        if self._asked:
            self.create_timer(ASK_EVERY, self._ask, clock=steady)

    # --- what arrives ------------------------------------------------------------------------------------------------

    def _hear(self, source: Source) -> Any:
        def on_message(message: Any) -> None:
            self._take(source.key, message)

        return on_message

    def _take(self, key: str, message: Any) -> None:
        self._received[key] = Received(message, time.monotonic_ns())
        now = time.monotonic()
        report = self._known(now)
        changed = report.status != self._report.status
        self._report = report
        if report.received_time:
            self.guard.on_status(report.status, now)
        if changed:
            self._decide(now)

    def _known(self, now: float) -> Report:
        report = assemble(self.adapter, self._received, round(now * NANOSECONDS))
        return confirmed(report, self._confirmation, now)

    def _on_joints(self, message: JointState) -> None:
        q = joint_positions(message, self.monitored.chain.joints)
        self._q = np.full(self.monitored.chain.n, math.nan) if q is None else q
        stamp = stamp_ns(message.header.stamp)
        self.guard.on_joints(self._q, time.monotonic(), stamp / NANOSECONDS if stamp else math.nan)

    def _ask(self) -> None:
        """Ask the adapter's services again; an answer that does not come is given up, for its server may be gone."""
        now = time.monotonic()
        for source in self.adapter.sources:
            if not source.is_service:
                continue
            client, pending, since = self._asked[source.key]
            if pending is not None and now - since < 3.0 * ASK_EVERY:
                continue
            if pending is not None:
                client.remove_pending_request(pending)
            pending = client.call_async(client.srv_type.Request()) if client.service_is_ready() else None
            if pending is not None:
                pending.add_done_callback(self._answer(source.key))
            self._asked[source.key] = (client, pending, now)

    def _answer(self, key: str) -> Any:
        def on_done(future: Any) -> None:
            client, pending, since = self._asked[key]
            if pending is future:
                self._asked[key] = (client, None, since)
            if future.exception() is None and future.result() is not None:
                self._take(key, future.result())

        return on_done

    # --- what is said ------------------------------------------------------------------------------------------------

    def _on_pulse(self) -> None:
        now = time.monotonic()
        self._watch_clock()
        report = self._known(now)
        if report.status != self._report.status:  # a source fell silent, or a confirmation ended
            self._report = report
            self.guard.on_status(report.status, now)
        elif not self.adapter.sources and self._confirmation is not None:
            self.guard.on_status(report.status, now)
        self._decide(now)
        if self._last is not None:
            self._emergency.look(now, permitted=self._last.permitted, speed=self._last.speed)

    def _watch_clock(self) -> None:
        before, self._ros_time = self._ros_time, self.now_ns()
        advance = (self._ros_time - before) / NANOSECONDS
        if before and not -1e-3 <= advance <= self.value("clock_jump"):
            self.guard.on_clock_jump()

    def _decide(self, now: float) -> None:
        with self._deciding:
            self._publish(self.guard.decide(now), now)

    def _publish(self, decision: Decision, now: float) -> None:
        stamp = self.now_ns()
        message = to_permission(decision, self.rules, stamp, hears=self._emergency.hears(now))
        self._permission.publish(message)
        before, self._last = self._last, decision
        changed = before is None or (before.permitted, before.reasons, before.latched) != (
            decision.permitted, decision.reasons, decision.latched,
        )  # fmt: skip
        if changed or now - self._evidence_sent >= 1.0 / self.value("evidence_rate"):
            self._evidence_sent = now
            state = to_robot_state(self._report, stamp, steady_to_ros=stamp - round(now * NANOSECONDS))
            self._state.publish(state)
            self._evidence.publish(to_evidence(decision, message, state, self.monitored, self.rules, self._q))
        if changed:
            self.diagnostics.report("permission", 0 if decision.permitted else 1, decision.text)
            if before is not None and before.permitted and not decision.permitted:
                self.get_logger().warning(f"motion is no longer permitted: {decision.text}")
            else:
                self.get_logger().info(decision.text)

    # --- what the operator says --------------------------------------------------------------------------------------

    def _on_reset(self, request: Any, response: Any) -> Any:
        now = time.monotonic()
        decision = self.guard.decide(now) if not request.operator_name.strip() else self.guard.reset(now)
        self._publish(decision, now)
        response.permission = to_permission(decision, self.rules, self.now_ns(), hears=self._emergency.hears(now))
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
        try:
            self._confirmation = checked(request.operator_name, request.operating_mode, request.valid_for, now)
        except InputError as error:
            response.outcome = to_outcome(Outcome.INPUT_UNUSABLE, str(error))
            return response
        self._report = self._known(now)
        self.guard.on_status(self._report.status, now)
        self._decide(now)
        response.confirmed_until = to_stamp(self.now_ns() + round(request.valid_for * NANOSECONDS))
        text = f"{self._confirmation.operator} confirms {self._confirmation.mode.name} for {request.valid_for:.0f} s"
        self.get_logger().info(text)
        response.outcome = to_outcome(Outcome.OK, text)
        return response

    def stop(self) -> None:
        """Take the permission back before the pulse ends."""
        with self._deciding:  # the executor's thread still decides
            self.guard.stop()
            self._decide(time.monotonic())


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(GuardNode, args)


if __name__ == "__main__":
    sys.exit(main())
