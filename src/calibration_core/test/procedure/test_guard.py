"""The guard against the rules of permission, stated a second time and in another way, on random sequences."""

from __future__ import annotations

import dataclasses
import math
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.procedure.guard import Guard, GuardRules
from calibration_core.procedure.robot_status import TEXT, Drives, OperatingMode, Reason, RobotStatus, Safety
from calibration_core.procedure.speed import Monitored

GOOD = RobotStatus(OperatingMode.MANUAL_REDUCED, Drives.ON, Safety.NORMAL, True, False, False, 1.0)
RULES = GuardRules()
SEQUENCES = int(os.environ.get("GUARD_SEQUENCES", "600"))  # `make bench` runs 10,000
ARM = Chain(  # a planar arm of two metres: the speed of its end is easy to say
    joints=("a", "b", "c"),
    rotation=np.tile(np.eye(3), (3, 1, 1)),
    translation=np.array([[0.0, 0, 0], [1.0, 0, 0], [0.5, 0, 0]]),
    offset=np.zeros(3),
    flange_rotation=np.eye(3),
    flange_translation=np.array([0.5, 0, 0]),
    limits=np.tile([-3.0, 3.0], (3, 1)),
    gravity=np.zeros(3),
)
END = Monitored(ARM, ("a", "b", "c", "flange"), np.zeros((1, 3)), np.zeros((4, 3)))


def end_speed(q: np.ndarray, rate: np.ndarray) -> float:
    """Return the larger of the speeds of the arm's joints and end, m/s, by plane geometry."""
    angle, turning = np.cumsum(q), np.cumsum(rate)
    links = np.array([1.0, 0.5, 0.5])
    velocity = np.cumsum(links * turning * np.exp(1j * (angle + np.pi / 2)))
    return float(np.abs(velocity).max())


def running(start: float = 0.0) -> tuple[Guard, float]:
    """Return a guard that permits motion, and the time."""
    guard, now = Guard(END, RULES), start
    for _ in range(3):
        now += 0.02
        guard.on_status(GOOD, now)
        guard.on_joints(np.zeros(3), now, now)
    assert guard.decide(now).permitted
    return guard, now


# --- the rules, stated again ------------------------------------------------------------------------------------------


@dataclasses.dataclass
class History:
    """Everything that arrived, as it arrived; nothing derived is kept between questions but what was decided."""

    rules: GuardRules
    states: list = dataclasses.field(default_factory=list)  # (received, status)
    joints: list = dataclasses.field(default_factory=list)  # (received, stamp, q)
    decided: list = dataclasses.field(default_factory=list)  # (time, forbidden, latched)
    arrived: int = 0  # joint messages judged at the last decision

    def measurements(self) -> list[tuple[float, float, np.ndarray, bool]]:
        """Return (received, time, q, jumped) of joint messages that are new measurements, since the last bad one."""
        found: list = []
        for received, stamp, q in self.joints:
            if len(q) != 3 or not all(map(math.isfinite, q)):
                found = []
                continue
            time = received if math.isnan(stamp) else stamp
            if found and 0 >= time - found[-1][1] >= -self.rules.clock_tolerance:
                continue
            jumped = bool(found) and bool(
                max(abs(a - b) for a, b in zip(q, found[-1][2], strict=True))
                > self.rules.jump_rate * max(time - found[-1][1], 1e-3)
            )
            found.append((received, time, np.array(q), jumped))
        return found

    def against(self, now: float, planned: float | None) -> set[str]:
        """Return everything that speaks against motion now."""
        rules, found = self.rules, set()
        if self.decided and (
            now < self.decided[-1][0] - rules.clock_tolerance or now > self.decided[-1][0] + rules.max_pause
        ):
            found.add("CLOCK_JUMPED")
        if planned is not None and (math.isnan(planned) or planned > rules.speed_limit):
            found.add("PLANNED_OVER_SPEED")
        found |= self._against_joints(now)
        found |= self._against_state(now)
        return found

    def _against_joints(self, now: float) -> set[str]:
        rules, found = self.rules, set()
        last_bad = bool(self.joints) and not (
            len(self.joints[-1][2]) == 3 and all(map(math.isfinite, self.joints[-1][2]))
        )
        every = self.measurements()
        if self._jumped_since():
            found.add("JOINTS_JUMPED")
        if last_bad:
            return found | {"JOINTS_NOT_FINITE"}
        series = self._unbroken(every)
        if len(series) < 2:
            found.add("JOINTS_ABSENT")
        if every and not -rules.clock_tolerance <= now - every[-1][0] <= rules.max_joints_age:
            found.add("JOINTS_STALE")
        if len(series) >= 2:
            newest = series[-1]
            older = [s for s in series[:-1] if s[1] <= newest[1] - rules.speed_window]
            first = older[-1] if older else series[0]
            rate = (newest[2] - first[2]) / (newest[1] - first[1])
            if end_speed((newest[2] + first[2]) / 2, rate) > 1.1 * rules.speed_limit:
                found.add("OVER_SPEED")
        moving = bool(self.states) and self.states[-1][1].in_motion is True
        if moving and every:
            since = every[-1][0]
            for received, _, q, _ in reversed(every):
                if not np.array_equal(q, every[-1][2]):
                    break
                since = received
            if not -rules.clock_tolerance <= now - since <= rules.freeze_time:
                found.add("JOINTS_FROZEN")
        return found

    def _jumped_since(self) -> bool:
        """Tell whether any message since the last decision was a jump, even if a bad one came after it."""
        for end in range(self.arrived + 1, len(self.joints) + 1):
            upto = History(self.rules, joints=self.joints[:end]).measurements()
            before = History(self.rules, joints=self.joints[: end - 1]).measurements()
            if upto and upto[-1][3] and (len(upto) != len(before)):
                return True
        return False

    def _unbroken(self, every: list) -> list:
        """Return the measurements since the sender's clock last went back or paused."""
        start = 0
        for i in range(1, len(every)):
            if not 0 < every[i][1] - every[i - 1][1] <= self.rules.max_pause:
                start = i
        return every[start:]

    def _against_state(self, now: float) -> set[str]:
        rules = self.rules
        if not self.states:
            return {"STATE_ABSENT"}
        received, s = self.states[-1]
        found = set()
        if not -rules.clock_tolerance <= now - received <= rules.max_state_age:
            found.add("STATE_STALE")
        valid = s.operator_confirmed and s.confirmed_until > now
        if s.operator_confirmed and not valid:
            found.add("CONFIRMATION_EXPIRED")
        if s.operating_mode == 0:
            found.add("MODE_UNKNOWN")
        elif s.operating_mode not in rules.allowed_modes:
            found.add("MODE_NOT_ALLOWED")
        else:
            limits = [x for x in (s.speed_limit, rules.declared_limit) if x is not None and 0 < x <= rules.speed_limit]
            if not (s.operating_mode == 1 or limits or (s.operating_mode == 5 and valid)):
                found.add("SPEED_LIMIT_MISSING")
        found |= {0: {"DRIVES_UNKNOWN"}, 1: {"DRIVES_OFF"}, 2: set()}[int(s.drives)]
        found |= {0: {"SAFETY_UNKNOWN"}, 1: set(), 2: set()}.get(int(s.safety), {"SAFETY_STOP"})
        if s.motion_possible is False:
            found.add("MOTION_NOT_POSSIBLE")
        if s.in_error is True:
            found.add("IN_ERROR")
        since = None
        for arrived, state in self.states:
            since = (arrived if since is None else since) if state.speed_scaling == 0 else None
        if since is not None and not -rules.clock_tolerance <= now - since <= rules.scaling_zero_time:
            found.add("SPEED_SCALING_ZERO")
        return found

    def decide(self, now: float, planned: float | None) -> tuple[set[str], set[str]]:
        """Return what speaks against motion, and what is latched."""
        live = self.against(now, planned)
        latched = set(self.decided[-1][2]) if self.decided else set()
        if self.decided and not self.decided[-1][1]:
            latched |= live - {"PLANNED_OVER_SPEED"}
        latched |= live & {"OVER_SPEED", "JOINTS_JUMPED", "CLOCK_JUMPED"}
        forbidden = live | ({"LATCHED"} if latched else set())
        self.decided.append((now, forbidden, latched))
        self.arrived = len(self.joints)
        return forbidden, latched

    def reset(self, now: float) -> tuple[set[str], set[str]]:
        """Do as `decide`, and release what is latched if nothing else speaks against motion."""
        forbidden, latched = self.decide(now, None)
        if forbidden <= {"LATCHED"}:
            self.decided[-1] = (now, forbidden, set())
            return self.decide(now, None)
        return forbidden, latched


# --- random sequences -------------------------------------------------------------------------------------------------

MODES = frozenset({OperatingMode.MANUAL_REDUCED, OperatingMode.AUTOMATIC, OperatingMode.MANUAL_UNSPECIFIED})
GAPS = st.sampled_from([0.0, 0.01, 0.02, 0.02, 0.02, 0.05, 0.09, 0.11, 0.25, 0.6, 1.5, -0.02, -0.4])
FAULTS = st.fixed_dictionaries(
    {},
    optional={
        "operating_mode": st.sampled_from(OperatingMode),
        "drives": st.sampled_from(Drives),
        "safety": st.sampled_from(Safety),
        "motion_possible": st.sampled_from([True, False, None]),
        "in_motion": st.sampled_from([True, False, None]),
        "in_error": st.sampled_from([True, False, None]),
        "speed_scaling": st.sampled_from([0.0, 1.0, math.nan]),
        "speed_limit": st.sampled_from([math.nan, 0.25, 0.5, 0.0]),
        "operator_confirmed": st.booleans(),
        "confirmed_until": st.sampled_from([math.nan, 0.3, 100.0]),
    },
)
STATUS = st.one_of(st.just({}), st.just({}), st.just({"in_motion": True}), FAULTS)
JOINTS = st.sampled_from(
    ["stand", "move", "move", "move", "fast", "jump", "nan", "short", "again", "earlier", "unstamped"]
)
MESSAGE = st.one_of(
    st.tuples(st.just("state"), STATUS),
    st.tuples(st.just("joints"), JOINTS),
    st.tuples(st.just("joints"), JOINTS),
    st.tuples(st.just("both"), st.just("move")),
    st.tuples(st.just("both"), st.just("move")),
    st.tuples(st.just("decide"), st.sampled_from([None, None, 0.2, 0.3, math.nan])),
    st.tuples(st.just("reset"), st.none()),
)


class _Sender:
    """Joint angles as a robot, or a fault, would send them."""

    def __init__(self) -> None:
        self.q, self.stamp = np.array([0.1, 0.4, -0.3]), -1.0

    def message(self, kind: str, now: float) -> tuple[np.ndarray, float]:
        steps = {"move": 1e-3, "unstamped": 1e-3, "fast": 2e-2, "jump": 1.0}
        self.q = self.q + steps.get(kind, 0.0)
        if kind == "nan":
            return np.array([0.1, math.nan, 0.2]), now
        if kind == "short":
            return np.zeros(2), now
        if kind == "unstamped":
            return self.q, math.nan
        if kind == "earlier":
            return self.q, now - 0.3
        if kind != "again":
            self.stamp = now
        return self.q, self.stamp


@settings(max_examples=SEQUENCES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    sequence=st.lists(st.tuples(GAPS, MESSAGE), min_size=4, max_size=14),
    declared=st.sampled_from([None, 0.25, 1.0]),
    warm=st.booleans(),
)
def test_never_a_permission_that_the_rules_forbid(sequence: list, declared: float | None, warm: bool) -> None:
    rules = dataclasses.replace(RULES, allowed_modes=MODES, declared_limit=declared)
    guard, history, sender, now = Guard(END, rules), History(rules), _Sender(), 0.0
    good = [(0.02, ("both", "move"))] * 2 if warm else []
    for gap, (kind, value) in [*good, *sequence]:
        now += gap
        planned = None
        if kind in {"state", "both"}:
            status = dataclasses.replace(GOOD, **(value if kind == "state" else {}))
            guard.on_status(status, now)
            history.states.append((now, status))
        if kind in {"joints", "both"}:
            q, stamp = sender.message(value, now)
            guard.on_joints(q, now, stamp)
            history.joints.append((now, stamp, q.tolist()))
        if kind == "decide":
            planned = value
        if kind == "reset":
            decision, (forbidden, latched) = guard.reset(now), history.reset(now)
        else:
            decision, (forbidden, latched) = guard.decide(now, planned), history.decide(now, planned)
        assert {reason.name for reason in decision.reasons} == forbidden
        assert {reason.name for reason in decision.latched} == latched
        assert decision.permitted == (not forbidden)


# --- single rules -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"operating_mode": OperatingMode.UNKNOWN}, Reason.MODE_UNKNOWN),
        ({"operating_mode": OperatingMode.AUTOMATIC}, Reason.MODE_NOT_ALLOWED),
        ({"operating_mode": OperatingMode.MANUAL_HIGH}, Reason.MODE_NOT_ALLOWED),
        ({"drives": Drives.OFF}, Reason.DRIVES_OFF),
        ({"drives": Drives.UNKNOWN}, Reason.DRIVES_UNKNOWN),
        ({"safety": Safety.EMERGENCY_STOP}, Reason.SAFETY_STOP),
        ({"safety": Safety.UNKNOWN}, Reason.SAFETY_UNKNOWN),
        ({"motion_possible": False}, Reason.MOTION_NOT_POSSIBLE),
        ({"in_error": True}, Reason.IN_ERROR),
        ({"operator_confirmed": True}, Reason.CONFIRMATION_EXPIRED),
    ],
)
def test_a_lost_condition_stops_and_latches(change: dict, reason: Reason) -> None:
    guard, now = running()
    guard.on_status(dataclasses.replace(GOOD, **change), now + 0.01)
    decision = guard.decide(now + 0.01)
    assert decision.reasons == (reason, Reason.LATCHED)
    assert TEXT[reason] in decision.text
    guard.on_status(GOOD, now + 0.02)
    assert guard.decide(now + 0.02).reasons == (Reason.LATCHED,)  # good again, and still no permission
    guard.on_joints(np.zeros(3), now + 0.03)
    assert guard.reset(now + 0.03).permitted


def test_reset_needs_the_cause_to_be_gone() -> None:
    guard, now = running()
    bad = dataclasses.replace(GOOD, drives=Drives.OFF)
    guard.on_status(bad, now)
    assert not guard.decide(now).permitted
    assert Reason.LATCHED in guard.reset(now).reasons


def test_staleness_is_seen_when_the_age_has_passed() -> None:
    guard, now = running()
    assert guard.decide(now + 0.09).permitted
    assert Reason.JOINTS_STALE in guard.decide(now + 0.11).reasons
    guard, now = running()
    for i in range(1, 30):
        guard.on_joints(np.zeros(3), now + 0.02 * i, now + 0.02 * i)
        decision = guard.decide(now + 0.02 * i)
        assert decision.permitted == (0.02 * i <= RULES.max_state_age + 1e-9)
    assert decision.latched == (Reason.STATE_STALE,)


def test_repeated_stamps_are_stale_and_repeated_values_in_motion_are_frozen() -> None:
    guard, now = running()
    for i in range(1, 8):
        guard.on_status(GOOD, now + 0.02 * i)
        guard.on_joints(np.zeros(3), now + 0.02 * i, now)  # arrives, but was measured long ago
        decision = guard.decide(now + 0.02 * i)
    assert Reason.JOINTS_STALE in decision.reasons
    guard, now = running()
    for i in range(1, 8):
        guard.on_status(dataclasses.replace(GOOD, in_motion=True), now + 0.02 * i)
        guard.on_joints(np.zeros(3), now + 0.02 * i, now + 0.02 * i)
        decision = guard.decide(now + 0.02 * i)
    assert decision.latched == (Reason.JOINTS_FROZEN,)


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_over_speed_is_measured(demo_cell: Cell, rate: float) -> None:
    """A turn of joint 1: the farthest point's speed is its distance from the axis times the rate."""
    chain = chain_of(demo_cell)
    monitored = Monitored.of(chain, nominal_parameters(demo_cell))
    guard, q, now = Guard(monitored, RULES), np.array([0.0, 0.2, -0.3, 0.1, 0.8, 0.0]), 0.0
    unit = monitored.speeds(q[None], np.eye(6)[:1])[0].max()
    speed = rate * RULES.speed_limit
    seen = []
    for _ in range(20):
        now += 0.01
        q = q + np.eye(6)[0] * speed / unit * 0.01
        guard.on_status(dataclasses.replace(GOOD, in_motion=True), now)
        guard.on_joints(q, now, now)
        seen.append(guard.decide(now))
    assert seen[-1].speed == pytest.approx(speed, rel=1e-3)
    assert seen[-1].speed_point in monitored.names
    assert (Reason.OVER_SPEED in seen[-1].reasons) == (rate > 1.1)
    if rate > 1.1:
        assert Reason.OVER_SPEED in seen[1].reasons  # from the second sample on


def test_modes_other_than_reduced_need_a_declared_limit() -> None:
    automatic = dataclasses.replace(GOOD, operating_mode=OperatingMode.AUTOMATIC)
    for declared, reported, permitted in (
        (None, math.nan, False),
        (0.25, math.nan, True),
        (None, 0.2, True),
        (0.3, 0.5, False),
    ):
        rules = dataclasses.replace(RULES, allowed_modes=MODES, declared_limit=declared)
        guard = Guard(END, rules)
        for now in (0.0, 0.02):
            guard.on_status(dataclasses.replace(automatic, speed_limit=reported), now)
            guard.on_joints(np.zeros(3), now, now)
        decision = guard.decide(0.02)
        assert decision.permitted == permitted
        assert (Reason.SPEED_LIMIT_MISSING in decision.reasons) != permitted


def test_operator_confirmation_expires() -> None:
    guard = Guard(END, dataclasses.replace(RULES, allowed_modes=MODES))
    confirmed = dataclasses.replace(
        GOOD, operating_mode=OperatingMode.MANUAL_UNSPECIFIED, operator_confirmed=True, confirmed_until=0.05
    )
    permitted = []
    for now in (0.0, 0.02, 0.04, 0.06):
        guard.on_status(confirmed, now)
        guard.on_joints(np.zeros(3), now, now)
        permitted.append(guard.decide(now).permitted)
    assert permitted == [False, True, True, False]
    assert Reason.CONFIRMATION_EXPIRED in guard.decide(0.06).latched


def test_planned_speed_is_refused_without_latching() -> None:
    guard, now = running()
    assert guard.decide(now, 0.26).reasons == (Reason.PLANNED_OVER_SPEED,)
    assert guard.decide(now, math.nan).reasons == (Reason.PLANNED_OVER_SPEED,)
    assert guard.decide(now, 0.25).permitted


def test_clock_jumps_and_the_end() -> None:
    for jump in (-0.5, 5.0):
        guard, now = running(10.0)
        assert Reason.CLOCK_JUMPED in guard.decide(now + jump).latched
    guard, now = running()
    guard.stop()
    assert Reason.STOPPING in guard.decide(now).reasons


def test_paused_by_the_controller() -> None:
    guard, now = running()
    for i in range(1, 20):
        guard.on_status(dataclasses.replace(GOOD, speed_scaling=0.0), now + 0.02 * i)
        guard.on_joints(np.zeros(3), now + 0.02 * i, now + 0.02 * i)
        decision = guard.decide(now + 0.02 * i)
    assert decision.latched == (Reason.SPEED_SCALING_ZERO,)


def test_every_reason_has_a_text() -> None:
    assert set(TEXT) == set(Reason)
