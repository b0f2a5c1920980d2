"""The guard against the rules of permission, stated a second time and in another way, on random sequences."""

from __future__ import annotations

import dataclasses
import itertools
import math
import os

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration_core.motion.guard import STATE_LASTS, Guard, GuardRules
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState
from calibration_core.motion.speed import Monitored
from calibration_core.motion.stop_proof import RequestedStop

GOOD = RobotStatus(OperatingMode.MANUAL_REDUCED, Drives.ON, SafetyState.NORMAL, True, False, False, 1.0)
RULES = GuardRules(remote=False)
SEQUENCES = int(os.environ.get("GUARD_SEQUENCES", "600"))  # `make bench` runs 10,000


def end_speed(q: np.ndarray, rate: np.ndarray) -> float:
    """Return the larger of the speeds of the arm's joints and end, m/s, by plane geometry."""
    angle, turning = np.cumsum(q), np.cumsum(rate)
    links = np.array([1.0, 0.5, 0.5])
    velocity = np.cumsum(links * turning * np.exp(1j * (angle + np.pi / 2)))
    return float(np.abs(velocity).max())


# --- the rules, stated again ------------------------------------------------------------------------------------------


@dataclasses.dataclass
class History:
    """Everything that arrived, as it arrived; nothing derived is kept between questions but what was decided."""

    rules: GuardRules
    states: list = dataclasses.field(default_factory=list)  # (received, status)
    joints: list = dataclasses.field(default_factory=list)  # (received, stamp, q)
    decided: list = dataclasses.field(default_factory=list)  # (time, forbidden, latched)
    arrived: int = 0  # joint messages judged at the last decision

    def measurements(self) -> list[tuple[float, float, np.ndarray, bool, int]]:
        """Return (received, time, q, jumped, number) of messages that are new measurements, since the last bad one."""
        found: list = []
        for number, (received, stamp, q) in enumerate(self.joints):
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
            found.append((received, time, np.array(q), jumped, number))
        return found

    def against(self, now: float, planned: float | None) -> set[str]:
        """Return everything that speaks against motion now."""
        rules, found = self.rules, set()
        if self.decided:
            last, forbidden, _ = self.decided[-1]
            paused = not forbidden and now > last + rules.max_pause
            if paused or now < last - rules.clock_tolerance:
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
            found.add("SPEED_UNKNOWN" if self._ever() else "JOINTS_ABSENT")
        if every and not -rules.clock_tolerance <= now - every[-1][0] <= rules.max_joints_age - self._late():
            found.add("JOINTS_STALE")
        if self._too_fast(series):
            found.add("OVER_SPEED")
        moving = bool(self.states) and self.states[-1][1].in_motion is True
        if moving and every:
            since = begun = every[-1][0]
            for received, _, q, *_ in reversed(every):
                if not np.array_equal(q, every[-1][2]):
                    break
                since = received
            for received, status in reversed(self.states):
                if status.in_motion is not True:
                    break
                begun = received
            since = max(since, begun)
            if not -rules.clock_tolerance <= now - since <= rules.freeze_time:
                found.add("JOINTS_FROZEN")
        return found

    def _too_fast(self, series: list) -> bool:
        """Tell whether the end has gone farther, in any of the times looked at, than it is planned to and may seem to.

        Its levers are 2, 1 and 0.5 m: 3.5 m times the error of a difference of angles.  The elbows move more slowly,
        and what they seem to move is known better.
        """
        error = 3.5 * self.rules.joint_error + self.rules.speed_limit * self.rules.time_error
        window, number = error / (0.02 * 0.25), len(series)
        while number > 2 and series[len(series) - number + 1][1] <= series[-1][1] - window:
            number -= 1
        for back in {back for back in (1, 2, 4, 8, 16, number - 1) if 0 < back < number}:
            span = series[-1][1] - series[-1 - back][1]
            moved = series[-1][2] - series[-1 - back][2]
            path = end_speed(series[-1][2] - moved / 2, moved)
            if path > 0.96 * 0.25 * span + max(error, 0.02 * 0.25 * span):
                return True
        return False

    def _ever(self) -> bool:
        """Tell whether any joint state with all its angles has come at all."""
        return any(len(q) == 3 and all(map(math.isfinite, q)) for _, _, q in self.joints)

    def _late(self) -> float:
        """Return how much later than it could the last joint state arrived; clocks drift apart by 1 ms/s."""
        delays, late = [], 0.0
        for end in range(1, len(self.joints) + 1):
            upto = History(self.rules, joints=self.joints[:end]).measurements()
            received, stamp, _ = self.joints[end - 1]
            if not upto or upto[-1][4] != end - 1:
                continue
            late = 0.0
            if not math.isnan(stamp):
                delays.append((received, received - stamp))
                late = received - stamp - self._least(delays)
        return late

    @staticmethod
    def _least(delays: list) -> float:
        """Return the smallest delay of all; one of the past may have grown since, as long as time went on."""
        gone = [max(later - earlier, 0.0) for (earlier, _), (later, _) in itertools.pairwise(delays)] + [0.0]
        return min(delay + 1e-3 * sum(gone[i:]) for i, (_, delay) in enumerate(delays))

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
        if not -rules.clock_tolerance <= now - received <= STATE_LASTS:
            found.add("STATE_STALE")
        valid = s.operator_confirmed and s.confirmed_until is not None and s.confirmed_until > now
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
        "safety": st.sampled_from(SafetyState),
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
def test_never_a_permission_that_the_rules_forbid(
    plane_arm: Monitored, sequence: list, declared: float | None, warm: bool
) -> None:
    rules = dataclasses.replace(RULES, allowed_modes=MODES, declared_limit=declared)
    guard, history, sender, now = Guard(plane_arm, rules, RequestedStop.NONE), History(rules), _Sender(), 0.0
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
