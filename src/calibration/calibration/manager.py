"""`manager`: notices a node that falls silent, and tells the state of the cell.

It moves nothing, permits nothing, ends no node because another one has ended, and starts none: that is the launch's.
`calibration/state` is everything that a panel needs, in one message.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from calibration_interfaces.msg import (
    Condition,
    Conditions,
    Fault,
    NodeHealth,
    Permission,
    ProcedureState,
    SampleCheck,
    State,
)
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile

from calibration.cell.watches import SILENT
from calibration.conversions import to_header
from calibration.node import FRESH, LEASE, QOS, TOPIC, CalibrationNode, Declared, run
from calibration.rclpy_gaps import Waiting
from calibration.topics import (
    CONDITIONS_QUALITY,
    PERMISSION,
    PROCEDURE,
    PROGRESS,
    READING,
    ROBOT_STATE,
    SAMPLE_CHECK,
    STATE,
    profile,
)
from calibration_core.cell import load_cell
from calibration_core.measurement.target_check import PUT_RIGHT, TARGETS

START = "start it again: ros2 run calibration {name}"
MISSED = {
    "guard": "nothing may move, and only the hand on the pendant stops the robot",
    "sequencer": "nothing is measured",
    "recorder": "nothing is recorded",
    "tracker": "no point is measured",
    "force_torque": "no wrench is measured",
    "identification": "nothing can be identified; the measurement goes on",
    "compensation": "no target is corrected; the measurement goes on",
}
AGAIN = {
    "guard": "reset it by name if it asks for that, and resume motion by name",
    "sequencer": "go on with the session (in a terminal: the goal again with resume: true)",
}
NOT_PERMITTED = {
    Permission.STATE_ABSENT: "start the robot's driver, and choose the adapter that fits it",
    Permission.STATE_STALE: "look whether the robot's driver still publishes its state",
    Permission.MODE_UNKNOWN: "confirm by name that the mode is manual at reduced speed (guard/confirm_mode)",
    Permission.MODE_NOT_ALLOWED: "turn the mode selector to manual reduced speed",
    Permission.DRIVES_UNKNOWN: "look whether the robot's driver tells whether the drives are on",
    Permission.DRIVES_OFF: "hold the enabling device, and switch the drives on",
    Permission.SAFETY_STOP: "release the stop at the controller",
    Permission.MOTION_NOT_POSSIBLE: "start the driver's program at the controller",
    Permission.IN_ERROR: "acknowledge the error at the controller",
    Permission.JOINTS_ABSENT: "look whether joint states are published",
    Permission.JOINTS_STALE: "look whether joint states still come in time; if its clock was set, restart the driver",
    Permission.JOINTS_NOT_FINITE: "look what the driver says about its encoders",
    Permission.CONFIRMATION_EXPIRED: "confirm the mode again by name (guard/confirm_mode)",
    Permission.SPEED_LIMIT_MISSING: "declare the controller's safety-rated speed limit in the cell file",
    Permission.SPEED_SCALING_ZERO: "turn the speed override up, or release the stop",
    Permission.NOT_STARTED: "wait: the guard has just begun",
    Permission.SAFETY_UNKNOWN: "look whether the robot's driver tells its safety state",
    Permission.JOINTS_FROZEN: "look whether the driver repeats old joint states",
    Permission.JOINTS_JUMPED: "look whether two drivers publish joint states, or an encoder fails",
    Permission.OVER_SPEED: "find out why the robot was too fast, before anything else",
    Permission.PLANNED_OVER_SPEED: "plan a slower motion",
    Permission.CLOCK_JUMPED: "look at the clocks of the computers, or at the simulation's",
    Permission.STOPPING: "start the guard again",
    Permission.SPEED_UNKNOWN: "wait for the next joint states; if it stays, look whether the driver pauses",
    Permission.STOP_UNPROVEN: "start or resume the measurement: the stop is proven before anything moves",
    Permission.SEQUENCER_SILENT: "look why the sequencer hangs or has ended, and start it again",
    Permission.TWO_GUARDS: "end one of the two guards",
    Permission.TWO_SOURCES: "end the second driver or simulation; one that was killed is counted for 20 s more",
    Permission.LATCHED: "put the cause right, then reset the guard by name (guard/reset); that moves nothing",
}
STREAM = {
    SampleCheck.SILENT: "look at the instrument, its cable and its driver; for a tracker, lock the beam again",
    SampleCheck.NOT_FINITE: "look at the instrument: it sends no numbers",
    SampleCheck.FROZEN: "lock the beam again: the same sample comes again and again",
    SampleCheck.JUMP: "look whether the target is loose or the beam jumped to another one",
    SampleCheck.WRONG_FRAME: "give the frame that the instrument uses as parameter frame",
    SampleCheck.IMPLAUSIBLE: "look whether the unit given for the instrument is right",
    SampleCheck.OUT_OF_ORDER: "look at the clock of the instrument",
    SampleCheck.TWO_SOURCES: "end the second driver; one that was killed is counted for 20 s more",
    SampleCheck.INCOMPATIBLE_QOS: "change the quality of service of the driver, or of the node",
}


def faults(state: State, foreign: str = "") -> list[Fault]:
    """Return what is wrong, the gravest first; in the order of nodes, permission, streams and conditions else.

    Args:
        state: Of the cell.
        foreign: Another session than the one under way, of which readings are heard; empty: none is.
    """
    found = [
        *_nodes(state.nodes),
        *_permission(state),
        *_streams(state.streams),
        *_conditions(state),
        *_targets(state),
        *_progress(state),
        *(
            [
                _fault(
                    Fault.WARN,
                    "foreign_session",
                    "calibration/reading",
                    f"readings of {foreign} are heard, which is not the session under way: they count for nothing",
                    "end whoever plays a bag in this domain",
                )
            ]
            if foreign
            else []
        ),
    ]
    return sorted(found, key=lambda one: -int(one.level))


def _fault(level: int, code: str, source: str, text: str, remedy: str) -> Fault:
    return Fault(level=level, code=code, source=source, text=text, remedy=remedy)


def _nodes(nodes: Sequence[NodeHealth]) -> Iterator[Fault]:
    for one in nodes:
        missed = MISSED.get(one.name, "")
        remedy = "; then ".join(filter(None, [START.format(name=one.name), AGAIN.get(one.name, "")]))
        if one.level == NodeHealth.ABSENT:
            yield _fault(Fault.ERROR, "node_absent", one.name, f"{one.name} has not been heard yet: {missed}", remedy)
        elif one.level == NodeHealth.SILENT:
            yield _fault(Fault.ERROR, "node_silent", one.name, f"{one.name} is silent: {missed}", remedy)
        elif one.level == NodeHealth.ERROR:
            yield _fault(Fault.ERROR, "node_error", one.name, f"{one.name}: {one.text}", "")


def _permission(state: State) -> Iterator[Fault]:
    if not state.permission_known:
        if not any(one.name == "guard" for one in state.nodes if one.level >= NodeHealth.ABSENT):
            yield _fault(Fault.ERROR, "guard_silent", "guard", "the guard does not say whether the robot may move",
                         START.format(name="guard"))  # fmt: skip
        return
    permission = state.permission
    running = state.procedure_known and state.procedure.state not in (ProcedureState.NO_RUN, ProcedureState.FINISHED)
    unproven = list(permission.reasons) == [Permission.STOP_UNPROVEN]  # which a run does before its first motion
    if permission.permitted or (unproven and not running):
        return
    code = "guard_latched" if permission.latched else "not_permitted"
    waited = state.procedure_known and state.procedure.waits_for in (ProcedureState.GUARD, ProcedureState.OPERATOR)
    level = Fault.ERROR if permission.latched or waited else Fault.WARN
    remedies = [NOT_PERMITTED[reason] for reason in permission.reasons if reason in NOT_PERMITTED]
    yield _fault(level, code, "guard", f"motion is not permitted: {permission.text}", "; ".join(remedies))


def _streams(streams: Sequence[SampleCheck]) -> Iterator[Fault]:
    for one in streams:
        if one.problem in STREAM:
            yield _fault(Fault.ERROR, "stream", one.name, f"{one.name} ({one.topic}): {one.text}", STREAM[one.problem])


def _conditions(state: State) -> Iterator[Fault]:
    for one in state.conditions.conditions:
        if one.verdict == Condition.VIOLATED and not one.override.operator_name:
            text = f"{one.name} ({one.clause}): found {one.value}, expected {one.limit}"
            remedy = "put it right, or override it by name (sequencer/override_condition)"
            yield _fault(Fault.ERROR if one.shall else Fault.WARN, "condition", one.name, text, remedy)


def _targets(state: State) -> Iterator[Fault]:
    """Name what is wrong with tracker or targets, which an override by name takes as it is."""
    if state.procedure_known and state.procedure.question.endswith(PUT_RIGHT):
        text = state.procedure.question.removesuffix(PUT_RIGHT).removesuffix(": ")
        yield _fault(Fault.ERROR, "condition", TARGETS, text, PUT_RIGHT)


def _progress(state: State) -> Iterator[Fault]:
    procedure, progress = state.procedure, state.progress
    if procedure.reading_verdict in (ProcedureState.REPEATED, ProcedureState.GIVEN_UP) and state.procedure_known:
        place = f"configuration {procedure.reading_configuration}, step {procedure.reading_step}"
        yield _fault(Fault.WARN, "reading_rejected", "sequencer", f"{place}: {procedure.reading_text}",
                     "nothing: it is tried again, or a spare takes its place")  # fmt: skip
    if progress.suspicious:
        text = f"configuration {progress.configuration} does not fit the others: {progress.text}"
        yield _fault(Fault.WARN, "suspicious", f"configuration {progress.configuration}", text, "measure it again")


FOREIGN = 10.0  # s, for which a reading of another session is reported


class Whole:
    """What was heard last of everything, and the message that it makes; times are s of the steady clock."""

    def __init__(self, names: tuple[str, ...], permission_age: float) -> None:
        """Begin with nothing heard.

        Args:
            names: Of the nodes, in their order.
            permission_age: s, that the guard's last word counts.
        """
        self._age = permission_age
        self._state = State(procedure=ProcedureState(seconds_left=math.nan, averaged=math.nan))
        self._streams: dict[tuple[str, str], SampleCheck] = {}
        self.health = {name: NodeHealth(name=name, level=NodeHealth.ABSENT) for name in names}
        self._heard = dict.fromkeys(names, -math.inf)
        self._looked = -math.inf
        self._permission_heard = -math.inf
        self._procedure_heard = False
        self._foreign = (-math.inf, "")

    def hear(self, field: str, message: Any, now: float) -> None:
        """Take a message that one field of the state shows as it came."""
        setattr(self._state, field, message)
        if field == "permission":
            self._permission_heard = now
        elif field == "procedure":
            self._procedure_heard = True

    def hear_reading(self, message: Any, now: float) -> None:
        """Take notice of a reading that is not of the session under way."""
        own, procedure = str(message.session).rpartition("@")[0], self._state.procedure
        if self._procedure_heard and own != (str(Path(procedure.session).absolute()) if procedure.session else ""):
            self._foreign = (now, str(message.session) or "no session")

    def hear_stream(self, message: SampleCheck) -> None:
        """Take the health of one stream."""
        self._streams[(str(message.topic), str(message.name))] = message

    def hear_node(self, message: NodeHealth, now: float) -> bool:
        """Take a node's sign of life; return whether it is news: it was not heard before, or was started again."""
        before = self.health.get(message.name)
        if before is None:
            return False
        self.health[message.name], self._heard[message.name] = message, now
        return before.level >= NodeHealth.ABSENT or before.identifier != message.identifier

    def silent(self, now: float) -> list[str]:
        """Return the nodes that fell silent since the last look; to be called several times within a lease.

        Whoever did not look for longer was too busy itself to hear them, and hears them first.
        """
        looked, self._looked = self._looked, now
        if now - looked > 0.5 * LEASE:
            return []
        late = [one for one in self.health.values() if one.level < NodeHealth.ABSENT]
        late = [one for one in late if now - self._heard[one.name] > LEASE]
        for one in late:
            one.level, one.text = NodeHealth.SILENT, f"silent: {MISSED.get(one.name, '')}"
        return [one.name for one in late]

    def message(self, now: float) -> State:
        """Return the state of the cell at `now`; a new run of the sequencer's process makes no old words true."""
        state = self._state
        for name, health in self.health.items():
            health.age = now - self._heard[name] if self._heard[name] > -math.inf else math.nan
        state.nodes = list(self.health.values())
        sequencer = self.health.get("sequencer")
        known = sequencer is not None and sequencer.level < NodeHealth.ABSENT and sequencer.age <= FRESH
        state.procedure_known = known and self._procedure_heard
        state.permission_known = now - self._permission_heard <= self._age
        state.streams = sorted(self._streams.values(), key=lambda one: (one.topic, one.name))
        if not state.permission_known:
            state.not_permitted = SILENT
        else:
            state.not_permitted = "" if state.permission.permitted else str(state.permission.text)
        procedure = state.procedure
        state.text, state.waiting = str(procedure.text), str(procedure.waiting)
        if not state.procedure_known:
            last = f"; it said last: {procedure.text}" if procedure.text else ""
            state.text, state.waiting = f"the sequencer is not heard{last}", "operator: start the sequencer again"
        elif procedure.waits_for == ProcedureState.GUARD and state.not_permitted:
            state.waiting = f"{procedure.waiting}: {state.not_permitted}"
        foreign = self._foreign[1] if now - self._foreign[0] <= FOREIGN else ""
        state.faults = faults(state, foreign)
        return state

    def news(self, state: State) -> dict[str, object]:
        """Return what of a state is worth a message at once; the rest of it changes all the time."""
        procedure, permission = state.procedure, state.permission
        felt = (procedure.load_felt_known, repr(procedure.load_felt), procedure.load_fault)
        return {
            "words": (state.text, state.waiting, state.not_permitted),
            "procedure": (procedure.state, procedure.moving, procedure.paused, procedure.configuration, procedure.step),
            "reading": (procedure.reading_verdict, procedure.reading_configuration, procedure.reading_step),
            "known": (state.procedure_known, state.permission_known),
            "permission": (permission.permitted, permission.latched, tuple(permission.reasons)),
            "fresh": [one.age <= FRESH for one in state.nodes],
            "nodes": [(one.identifier, one.level, one.text) for one in state.nodes],
            "faults": [(one.code, one.source, one.text) for one in state.faults],
            "streams": [(one.name, one.problem) for one in state.streams],
            "progress": state.progress.configuration,
            "conditions": [(one.name, one.verdict, one.override.operator_name) for one in state.conditions.conditions],
            "averaged": repr(procedure.averaged),
            "felt": felt if procedure.load_awaited else None,
        }


NAMES = ("guard", "recorder", "tracker", "force_torque", "identification", "sequencer", "compensation")
PERMISSION_AGE = 0.5  # s, that the guard's last word is shown
LOOK = 0.1  # s of wall time between two looks, and at least between two messages
PERIOD = 0.2  # s of wall time between two messages that tell nothing new: who reads them sees at once that none comes

PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("nodes", list(NAMES), "Nodes that are watched."),
)


class ManagerNode(CalibrationNode):
    """Watches and tells."""

    def __init__(self, **kwargs: Any) -> None:
        """Make the node.

        Raises:
            InputError: A parameter or the cell file cannot be used.
        """
        super().__init__("manager", PARAMETERS, **kwargs)

    def on_start(self) -> None:
        """Listen to every node, and to what they say of the cell."""
        cell = load_cell(self.value("cell"), live=True)
        self.whole = Whole(tuple(self.value("nodes")), PERMISSION_AGE)
        self._reported: dict[str, object] = {}
        self._sent = -math.inf
        self._publisher = self.create_publisher(STATE.message, STATE.relative, STATE.qos)
        parts = {"procedure": PROCEDURE, "permission": PERMISSION, "robot": ROBOT_STATE, "progress": PROGRESS}
        conditions, kept = cell.topics.conditions.lstrip("/"), profile(CONDITIONS_QUALITY)
        self._parts = {name: Waiting(self, one.message, one.relative, one.qos) for name, one in parts.items()}
        self._parts["conditions"] = Waiting(self, Conditions, conditions, kept)
        self._signs = Waiting(self, NodeHealth, TOPIC, QOS)
        self._checks = Waiting(self, SAMPLE_CHECK.message, SAMPLE_CHECK.relative, SAMPLE_CHECK.qos)
        now = QoSProfile(depth=100)  # what was said before belongs to no run under way
        self._readings = Waiting(self, READING.message, READING.relative, now)
        self.create_timer(LOOK, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # --- what is heard -----------------------------------------------------------------------------------------------

    def _take(self) -> None:
        for field, messages in self._parts.items():
            for message, arrived, _ in messages.arrivals():
                self.whole.hear(field, message, arrived)
        for message, arrived, _ in self._signs.arrivals():
            if self.whole.hear_node(message, arrived):
                self.get_logger().info(f"{message.name} is heard: process {message.process} on {message.computer}")
        for message in self._checks.take():
            self.whole.hear_stream(message)
        for message, arrived, _ in self._readings.arrivals():
            self.whole.hear_reading(message, arrived)

    def _look(self) -> None:
        self._take()
        now = time.monotonic()
        for name in self.whole.silent(now):
            self.get_logger().error(f"{name} is silent: {MISSED.get(name, 'it does not work')}")
        self._report(now)

    def _report(self, now: float) -> None:
        """Send the state if it is news, and once a period."""
        message = self.whole.message(now)
        news = self.whole.news(message)
        if news == self._reported and now - self._sent < PERIOD:
            return
        self._reported, self._sent = news, now
        message.header = to_header(self.now_ns())
        self._publisher.publish(message)
        gravest = max((int(one.level) for one in message.faults), default=0)
        self.diagnostics.report("cell", gravest, "; ".join(str(one.text) for one in message.faults) or "all is well")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run(ManagerNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
