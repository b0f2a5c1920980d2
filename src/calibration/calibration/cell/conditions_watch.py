"""The standard's conditions, watched while a plan is measured: what violates one stops the run until it is overridden.

Temperature and robot state are heard here; judged, published and stored they are by the runner's thread.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from calibration_interfaces.msg import Condition, ConditionOverride, Conditions, Outcome, RobotState
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Temperature

from calibration.conversions import to_header, to_outcome
from calibration.rclpy_gaps import Waiting
from calibration.topics import CONDITIONS_QUALITY, ROBOT_STATE, profile
from calibration_core import timeseries as core
from calibration_core.identification.checks.conditions import NAMES, CellState, expected_ratio, judge
from calibration_core.identification.stiffness.end_effector import relative_stiffness
from calibration_core.measurement import messages as m
from calibration_core.measurement.target_check import TARGETS
from calibration_core.measurement.thermometer import TemperatureHistory
from calibration_core.motion.robot_status import Drives, OperatingMode
from calibration_core.planning.plans.plan import Plan
from calibration_core.timeseries import NANOSECONDS

LOOK = 1.0  # s of wall time between two looks
REPORT_PERIOD = 30.0  # s of wall time, after which values are reported again although no verdict has changed
HEARD = 3.0  # s of wall time, a thermometer may take to be heard before a run


class ConditionsWatch:
    """Judges the conditions of the run that is under way.

    Attributes:
        scaling: Share of the programmed speed at which the controller moves, 0 to 1; NaN: not known.
    """

    def __init__(self, node: Any) -> None:
        """Offer the topic of the conditions, and listen to thermometer and robot state."""
        self._node = node
        self.scaling = math.nan
        self._thermometer = TemperatureHistory()
        self._mode, self._drives = "", Drives.UNKNOWN
        self._fixed: dict[str, float] = {}
        self._overrides: list[core.Override] = []
        self._reported: tuple[core.Condition, ...] = ()
        self._looked = self._sent = -math.inf
        topics = node.cell.topics
        self._publisher = node.create_publisher(Conditions, topics.conditions.lstrip("/"), profile(CONDITIONS_QUALITY))
        newest = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._temperatures = Waiting(node, Temperature, topics.temperature.lstrip("/"), newest)
        kept = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(RobotState, ROBOT_STATE.relative, self._on_state, kept)

    def take(self) -> None:
        """Take what the thermometer has said."""
        for message in self._temperatures.take():
            self._thermometer.hear(self._node.now_ns() / NANOSECONDS, float(message.temperature))

    @property
    def temperature(self) -> float:
        """Degrees Celsius, as last heard; NaN where nothing was."""
        return self._thermometer.at(self._node.now_ns() / NANOSECONDS)

    def _on_state(self, message: RobotState) -> None:
        self._node.watch.state(time.monotonic())
        self.scaling = float(message.speed_scaling)
        known = {int(mode): mode.name for mode in OperatingMode if mode is not OperatingMode.UNKNOWN}
        self._mode, self._drives = known.get(int(message.operating_mode), ""), Drives(int(message.drives))

    def thermometer_heard(self) -> bool:
        """Tell whether the thermometer has been heard, or there is none: without one, nothing is known."""
        topic = self._node.cell.topics.temperature.lstrip("/")
        return not math.isnan(self.temperature) or not self._node.count_publishers(topic)

    def begin(self, plan: Plan, speed: float, warm_up_period: float, overrides: Sequence[Any]) -> str:
        """Prepare for a plan; return what is wrong with the overrides, empty if nothing is.

        Args:
            plan: What will be measured.
            speed: m/s, no monitored point will be faster.
            warm_up_period: s, after which the start-up cycle is repeated; infinite: never.
            overrides: `ConditionOverride` messages of the goal.
        """
        wrong = [text for text in map(fault, overrides) if text]
        cell = self._node.cell
        self._fixed = {
            "warm_up_period": warm_up_period,
            "largest_force": plan.largest_force,
            "uncertainty_ratio": expected_ratio(plan.primary, cell),
            "tool_stiffness": relative_stiffness(cell, np.array([one.q for one in plan.primary])),
            "speed": speed,
        }
        self._overrides = [from_override(one) for one in overrides]
        self._reported, self._looked, self._sent = (), -math.inf, -math.inf
        return "; ".join(wrong)

    def judged(self, warm_up_age: float = math.nan) -> tuple[core.Condition, ...]:
        """Return how the conditions stand now."""
        state = CellState(
            temperature=self._thermometer.history(self._node.now_ns() / NANOSECONDS),
            mode=self._mode,
            drives={Drives.ON: True, Drives.OFF: False}.get(self._drives),
            warm_up_age=warm_up_age,
            **self._fixed,
        )
        return judge(state, self._node.cell, self._overrides)

    def violated(self) -> str:
        """Return what must not be and is not overridden, before a run begins; empty if nothing is."""
        return in_words([one for one in self.judged() if one.stops])

    def opened(self, session: Any) -> None:
        """Store the overrides of the goal, and take over those of an earlier run of the session."""
        for one in self._overrides:
            session.override(self._node.now_ns(), one)
        self._overrides = list(session.overrides)

    def override(self, request: Any, port: Any) -> None:
        """Take an override during a run, and store it; it is told at the next look."""
        one, now = from_override(request), self._node.now_ns()
        self._overrides.append(one)
        port.keep(lambda: port.session.override(now, one))
        self._looked = -math.inf

    def look(self, port: Any, runner: Any) -> None:
        """Judge again, now and then; tell of changes, and pause the run where one stops it.  In the runner's thread."""
        if time.monotonic() - self._looked < LOOK:
            return
        self._looked = time.monotonic()
        since = runner.sequence.queue.warmed_up
        found = self.judged(math.nan if since is None else port.seconds() - since)
        before = {one.name: one for one in self._reported}
        changed = [(one.met, one.override) for one in found] != [(one.met, one.override) for one in self._reported]
        if changed or self._looked - self._sent >= REPORT_PERIOD:
            now, self._sent = self._node.now_ns(), self._looked
            self._publisher.publish(to_conditions(now, found))
            port.keep(lambda: port.session.judge(now, found))
            for one in found:
                old = before.get(one.name)
                if one.met is False and (old is None or old.met is not False):
                    port.carry_out(m.Record(m.Kind.CONDITION_VIOLATED, 0, 0, in_words([one])))
                if one.override is not None and (old is None or old.override != one.override):
                    text = f"{one.name} by {one.override.operator}: {one.override.reason}"
                    port.carry_out(m.Record(m.Kind.CONDITION_OVERRIDDEN, 0, 0, text))
            self._reported = found
        stopping = [one for one in found if one.stops]
        if stopping and not runner.sequence.paused:
            port.carry_out(m.AskOperator(f"{in_words(stopping)}: override it by name, or put it right, then resume"))
            runner.post(m.Pause(0.0))


def fault(message: Any) -> str:
    """Return what is wrong with an override, empty if nothing is."""
    names = (*NAMES, TARGETS)
    if message.condition not in names:
        return f"condition: found {message.condition!r}, expected one of {', '.join(names)}"
    for name, value in (("operator_name", message.operator_name), ("reason", message.reason)):
        if not value.strip():
            return f"{name}: found nothing, expected who overrides {message.condition}, and why"
    return ""


def refused(message: Any, *, running: bool) -> Any:
    """Return the outcome that refuses an override; None if it can be taken."""
    text = fault(message) or ("" if running else "no plan is being measured: give overrides with the goal")
    return to_outcome(Outcome.INPUT_UNUSABLE, text) if text else None


def in_words(conditions: Sequence[core.Condition]) -> str:
    """Name conditions with value and limit."""
    return "; ".join(f"{one.name} ({one.clause}): found {one.value}, expected {one.limit}" for one in conditions)


def from_override(message: Any) -> core.Override:
    """Return the override in a message."""
    return core.Override(str(message.condition), str(message.operator_name).strip(), str(message.reason).strip())


def to_conditions(time_ns: int, conditions: Sequence[core.Condition]) -> Conditions:
    """Return conditions as a message."""
    verdicts = {None: Condition.UNKNOWN, True: Condition.MET, False: Condition.VIOLATED}
    rows = []
    for one in conditions:
        who = one.override
        given = ConditionOverride()
        if who is not None:
            given = ConditionOverride(condition=who.condition, operator_name=who.operator, reason=who.reason)
        words = {name: getattr(one, name) for name in ("name", "clause", "requirement", "limit", "value", "shall")}
        rows.append(Condition(**words, verdict=verdicts[one.met], override=given))
    return Conditions(header=to_header(time_ns), conditions=rows)
