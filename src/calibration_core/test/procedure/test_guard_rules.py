"""The guard's rules, one at a time."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.motion.guard import STATE_LASTS, Guard, GuardDecision, GuardRules
from calibration_core.motion.robot_status import TEXT, Drives, OperatingMode, Reason, RobotStatus, SafetyState
from calibration_core.motion.speed import Monitored
from calibration_core.motion.stop_proof import RequestedStop
from calibration_core.motion.trajectory import MotionLimits, plan_motion
from calibration_core.timeseries import Float1D, Float2D

GOOD = RobotStatus(OperatingMode.MANUAL_REDUCED, Drives.ON, SafetyState.NORMAL, True, False, False, 1.0)
RULES = GuardRules(remote=False)
MODES = frozenset({OperatingMode.MANUAL_REDUCED, OperatingMode.AUTOMATIC, OperatingMode.MANUAL_UNSPECIFIED})


def permitting(arm: Monitored, start: float = 0.0) -> tuple[Guard, float]:
    """Return a guard that permits motion, and the time."""
    guard, now = Guard(arm, RULES, RequestedStop.NONE), start
    for _ in range(3):
        now += 0.02
        guard.on_status(GOOD, now)
        guard.on_joints(np.zeros(3), now, now)
    assert guard.decide(now).permitted
    return guard, now


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"operating_mode": OperatingMode.UNKNOWN}, Reason.MODE_UNKNOWN),
        ({"operating_mode": OperatingMode.AUTOMATIC}, Reason.MODE_NOT_ALLOWED),
        ({"operating_mode": OperatingMode.MANUAL_HIGH}, Reason.MODE_NOT_ALLOWED),
        ({"drives": Drives.OFF}, Reason.DRIVES_OFF),
        ({"drives": Drives.UNKNOWN}, Reason.DRIVES_UNKNOWN),
        ({"safety": SafetyState.EMERGENCY_STOP}, Reason.SAFETY_STOP),
        ({"safety": SafetyState.UNKNOWN}, Reason.SAFETY_UNKNOWN),
        ({"motion_possible": False}, Reason.MOTION_NOT_POSSIBLE),
        ({"in_error": True}, Reason.IN_ERROR),
        ({"operator_confirmed": True}, Reason.CONFIRMATION_EXPIRED),
    ],
)
def test_a_lost_condition_stops_and_latches(plane_arm: Monitored, change: dict, reason: Reason) -> None:
    guard, now = permitting(plane_arm)
    guard.on_status(dataclasses.replace(GOOD, **change), now + 0.01)
    decision = guard.decide(now + 0.01)
    assert decision.reasons == (reason, Reason.LATCHED)
    assert TEXT[reason] in decision.text
    guard.on_status(GOOD, now + 0.02)
    assert guard.decide(now + 0.02).reasons == (Reason.LATCHED,)  # good again, and still no permission
    guard.on_joints(np.zeros(3), now + 0.03)
    assert guard.reset(now + 0.03).permitted


def test_reset_needs_the_cause_to_be_gone(plane_arm: Monitored) -> None:
    guard, now = permitting(plane_arm)
    bad = dataclasses.replace(GOOD, drives=Drives.OFF)
    guard.on_status(bad, now)
    assert not guard.decide(now).permitted
    assert Reason.LATCHED in guard.reset(now).reasons


def test_staleness_is_seen_when_the_age_has_passed(plane_arm: Monitored) -> None:
    guard, now = permitting(plane_arm)
    assert guard.decide(now + 0.09).permitted
    assert Reason.JOINTS_STALE in guard.decide(now + 0.11).reasons
    guard, now = permitting(plane_arm)
    for i in range(1, 30):
        guard.on_joints(np.zeros(3), now + 0.02 * i, now + 0.02 * i)
        decision = guard.decide(now + 0.02 * i)
        assert decision.permitted == (0.02 * i <= STATE_LASTS + 1e-9)
    assert decision.latched == (Reason.STATE_STALE,)


@pytest.mark.parametrize("offset", [-500.0, 0.0, 500.0])
@pytest.mark.parametrize(("late", "stale"), [(0.0, False), (0.09, False), (0.11, True), (2.0, True)])
def test_joint_states_that_arrive_late_are_stale(plane_arm: Monitored, offset: float, late: float, stale: bool) -> None:
    """Their age counts from their stamp on, whatever the sender's clock shows; another sender's is learnt anew."""
    guard = Guard(plane_arm, RULES, RequestedStop.NONE)
    for i in range(150):
        now = 0.02 * i
        measured = now - (late if i > 50 else 0.0)
        if i == 130:
            guard.on_new_source()
        guard.on_status(GOOD, now)
        guard.on_joints(np.zeros(3), now, measured + offset)
        decision = guard.decide(now)
        waits = 50 < i <= 50 + late / 0.02  # stamps repeat, or go back, until the first of the late ones is new
        if i > 1 and not waits:
            assert (Reason.JOINTS_STALE in decision.reasons) == (stale and 50 < i < 130)
        if stale and 50 < i < 130:
            assert not decision.permitted
    assert guard.reset(now).permitted
    simulated = Guard(plane_arm, dataclasses.replace(RULES, stamps_run=False), RequestedStop.NONE)
    for i in range(50):
        simulated.on_status(GOOD, 0.02 * i)
        simulated.on_joints(np.zeros(3), 0.02 * i, 0.002 * i)  # at a tenth of the speed
        assert i < 1 or simulated.decide(0.02 * i).permitted


def test_repeated_stamps_are_stale_and_repeated_values_in_motion_are_frozen(plane_arm: Monitored) -> None:
    guard, now = permitting(plane_arm)
    for i in range(1, 8):
        guard.on_status(GOOD, now + 0.02 * i)
        guard.on_joints(np.zeros(3), now + 0.02 * i, now)  # arrives, but was measured long ago
        decision = guard.decide(now + 0.02 * i)
    assert Reason.JOINTS_STALE in decision.reasons
    guard, now = permitting(plane_arm)
    for i in range(1, 8):
        guard.on_status(dataclasses.replace(GOOD, in_motion=True), now + 0.02 * i)
        guard.on_joints(np.zeros(3), now + 0.02 * i, now + 0.02 * i)
        decision = guard.decide(now + 0.02 * i)
    assert decision.latched == (Reason.JOINTS_FROZEN,)


# --- speed -----------------------------------------------------------------------------------------------------------

PLANNED, LIMIT = MotionLimits().allowed, RULES.speed_limit
DRIVERS = {  # Hz, rad, s: rate, step of the joint angles, spread of the stamps
    "10 Hz": (10.0, 0.0, 0.0),
    "10 Hz, coarse, unsteady": (10.0, 1e-4, 1e-3),
    "100 Hz": (100.0, 0.0, 0.0),
    "100 Hz, fine": (100.0, 1e-6, 0.0),
    "100 Hz, coarse, unsteady": (100.0, 1e-4, 1e-3),
    "500 Hz": (500.0, 0.0, 0.0),
    "500 Hz, coarse": (500.0, 1e-4, 0.0),
    "500 Hz, coarse, unsteady": (500.0, 1e-4, 1e-3),
}


def driver(time: Float1D, q: Float2D, kind: str, rng: np.random.Generator) -> tuple[Float1D, Float1D, Float2D]:
    """Return arrivals, stamps and angles that a driver makes of a motion (m,) s, (m, n) rad."""
    rate, step, spread = DRIVERS[kind]
    at = np.arange(time[0] + rng.uniform(0.0, 1.0 / rate), time[-1], 1.0 / rate)
    stamps = np.sort(at + rng.uniform(-0.5, 0.5, len(at)) * min(spread, 0.5 / rate))
    seen = np.stack([np.interp(at, time, column) for column in q.T], axis=1)
    return at + 2e-3, stamps, np.round(seen / step) * step if step else seen


def watched(monitored: Monitored, arrivals: Float1D, stamps: Float1D, q: Float2D) -> list[GuardDecision]:
    """Return what a guard decides 50 times a second about a robot about which all else is well."""
    guard = Guard(monitored, dataclasses.replace(RULES, max_joints_age=1.0), RequestedStop.NONE)
    decided: list[GuardDecision] = []
    for arrival, stamp, angles in zip(arrivals, stamps, q, strict=True):
        guard.on_status(dataclasses.replace(GOOD, in_motion=True), arrival)
        guard.on_joints(angles, arrival, stamp)
        if not decided or arrival - decided[-1].time >= 0.02 - 1e-9:
            decided.append(guard.decide(arrival))
    return decided


def steadily(monitored: Monitored, speed: float, rng: np.random.Generator) -> tuple[Float1D, Float2D]:
    """Return a motion, (m,) s and (m, n) rad, in which the fastest point always has this speed, m/s."""
    start, line = rng.uniform(-0.5, 0.5, (2, monitored.chain.n))
    s = np.linspace(0.0, 1.0, 2001)
    q = start + s[:, None] * line
    pace = speed / monitored.speeds(q, np.tile(line, (len(s), 1))).max(axis=1)  # ds/dt
    return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (pace[1:] + pace[:-1]))]), q


@pytest.mark.parametrize("kind", DRIVERS)
@pytest.mark.parametrize(
    ("speed", "stopped"),
    [(PLANNED, False), (1.02 * PLANNED, False), (1.05 * PLANNED, None), (LIMIT, None), (1.1 * PLANNED, True),
     (1.02 * LIMIT, True), (1.001 * LIMIT, True), (1.05 * LIMIT, True), (1.1 * LIMIT, True)],
)  # fmt: skip
def test_what_is_faster_than_the_limit_is_stopped_and_what_is_planned_is_not(
    demo_cell: Cell, speed: float, stopped: bool | None, kind: str
) -> None:
    """Between what is planned and the limit the measured speed decides, which is known to 2 % of the limit."""
    monitored = Monitored.of(chain_of(demo_cell), nominal_parameters(demo_cell), None)
    rng = np.random.default_rng([int(1e6 * speed), *map(ord, kind)])
    decided = watched(monitored, *driver(*steadily(monitored, speed, rng), kind, rng))
    fast = [Reason.OVER_SPEED in one.reasons for one in decided]
    assert stopped in {None, any(fast)}
    known = [one for one in decided if one.time - decided[0].time > 0.4]
    assert max(abs(one.speed - speed) for one in known) < 0.02 * LIMIT
    assert any(fast) or max(one.speed for one in known) <= 0.98 * LIMIT
    if stopped:
        assert decided[fast.index(True)].time - decided[0].time < 0.25 + 1.5 / DRIVERS[kind][0]


@pytest.mark.parametrize("kind", ["100 Hz", "500 Hz, coarse"])
@pytest.mark.parametrize(("speed", "within"), [(0.5, 0.04), (1.0, 0.03)])
def test_what_is_much_too_fast_is_seen_at_once(demo_cell: Cell, speed: float, kind: str, within: float) -> None:
    """From rest, and with up to 20 ms between two decisions."""
    monitored = Monitored.of(chain_of(demo_cell), nominal_parameters(demo_cell), None)
    rng = np.random.default_rng(3)
    time, q = steadily(monitored, speed, rng)
    before = np.arange(-1.0, 0.0, 1e-3)
    motion = np.concatenate([before, time]), np.concatenate([np.tile(q[0], (len(before), 1)), q])
    decided = watched(monitored, *driver(*motion, kind, rng))
    first = next(one for one in decided if Reason.OVER_SPEED in one.reasons)
    assert 0.0 < first.time < within
    assert first.speed_point in monitored.names
    assert first.speed > 0.96 * LIMIT


@pytest.mark.parametrize("kind", ["10 Hz, coarse, unsteady", "100 Hz, fine", "500 Hz, coarse, unsteady"])
def test_no_planned_motion_is_stopped(demo_cell: Cell, kind: str) -> None:
    """Rest to rest, with all its accelerations, as it is planned."""
    monitored = Monitored.of(chain_of(demo_cell), nominal_parameters(demo_cell), None)
    rng = np.random.default_rng(5)
    fastest = []
    for _ in range(4):
        motion = plan_motion(monitored, *rng.uniform(-0.8, 0.8, (2, 6)), MotionLimits(joint_acceleration=6.0))
        time = np.arange(0.0, motion.duration, 1e-3)
        decided = watched(monitored, *driver(time, motion.at(time)[0], kind, rng))
        assert not any(Reason.OVER_SPEED in one.reasons for one in decided)
        fastest.append(np.nanmax([one.speed for one in decided]))
    assert max(fastest) > 0.9 * PLANNED


def test_modes_other_than_reduced_need_a_declared_limit(plane_arm: Monitored) -> None:
    automatic = dataclasses.replace(GOOD, operating_mode=OperatingMode.AUTOMATIC)
    for declared, reported, permitted in (
        (None, math.nan, False),
        (0.25, math.nan, True),
        (None, 0.2, True),
        (0.3, 0.5, False),
    ):
        rules = dataclasses.replace(RULES, allowed_modes=MODES, declared_limit=declared)
        guard = Guard(plane_arm, rules, RequestedStop.NONE)
        for now in (0.0, 0.02):
            guard.on_status(dataclasses.replace(automatic, speed_limit=reported), now)
            guard.on_joints(np.zeros(3), now, now)
        decision = guard.decide(0.02)
        assert decision.permitted == permitted
        assert (Reason.SPEED_LIMIT_MISSING in decision.reasons) != permitted


def test_operator_confirmation_expires(plane_arm: Monitored) -> None:
    guard = Guard(plane_arm, dataclasses.replace(RULES, allowed_modes=MODES), RequestedStop.NONE)
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


def test_planned_speed_is_refused_without_latching(plane_arm: Monitored) -> None:
    guard, now = permitting(plane_arm)
    assert guard.decide(now, 0.26).reasons == (Reason.PLANNED_OVER_SPEED,)
    assert guard.decide(now, math.nan).reasons == (Reason.PLANNED_OVER_SPEED,)
    assert guard.decide(now, MotionLimits().allowed).permitted


def test_clock_jumps_and_the_end(plane_arm: Monitored) -> None:
    for jump in (-0.5, 5.0):
        guard, now = permitting(plane_arm, 10.0)
        assert Reason.CLOCK_JUMPED in guard.decide(now + jump).latched
    guard = Guard(plane_arm, RULES, RequestedStop.NONE)  # one that has permitted nothing yet, on a busy computer
    assert not guard.decide(1.0).permitted
    assert guard.decide(6.0).latched == ()
    guard, now = permitting(plane_arm)
    guard.stop()
    assert Reason.STOPPING in guard.decide(now).reasons


def test_paused_by_the_controller(plane_arm: Monitored) -> None:
    guard, now = permitting(plane_arm)
    for i in range(1, 20):
        guard.on_status(dataclasses.replace(GOOD, speed_scaling=0.0), now + 0.02 * i)
        guard.on_joints(np.zeros(3), now + 0.02 * i, now + 0.02 * i)
        decision = guard.decide(now + 0.02 * i)
    assert decision.latched == (Reason.SPEED_SCALING_ZERO,)


def test_every_reason_has_a_text() -> None:
    assert set(TEXT) == set(Reason)


def test_joint_states_that_came_are_never_called_absent(plane_arm: Monitored) -> None:
    guard = Guard(plane_arm, RULES, RequestedStop.NONE)
    guard.on_status(GOOD, 0.0)
    assert Reason.JOINTS_ABSENT in guard.decide(0.0).reasons
    guard.on_joints(np.array([0.0, math.nan, 0.0]), 0.01, 0.01)
    assert guard.decide(0.01).reasons == (Reason.JOINTS_NOT_FINITE,)
    guard.on_joints(np.zeros(3), 0.02, 0.02)
    assert guard.decide(0.02).reasons == (Reason.SPEED_UNKNOWN,)
    guard.on_joints(np.zeros(3), 0.03, 0.03)
    assert guard.decide(0.03).permitted


def test_one_bad_joint_state_is_named_until_the_reset(plane_arm: Monitored) -> None:
    guard, now = permitting(plane_arm)
    guard.on_joints(np.full(3, math.nan), now + 0.01, now + 0.01)
    guard.decide(now + 0.01)
    guard.on_joints(np.zeros(3), now + 0.02, now + 0.02)
    text = guard.decide(now + 0.02).text
    assert "no joint states have arrived" not in text
    assert "a joint state is not a finite number" in text


@pytest.mark.parametrize("stop", RequestedStop)
@pytest.mark.parametrize("remote", [True, False])
def test_motion_from_outside_is_asked_for_only_where_the_guard_can_stop_it(
    plane_arm: Monitored, stop: RequestedStop, remote: bool
) -> None:
    guard = Guard(plane_arm, GuardRules(remote=remote), stop)
    guard.on_status(dataclasses.replace(GOOD, motion_possible=False), 0.0)
    asked = Reason.MOTION_NOT_POSSIBLE in guard.decide(0.0).reasons
    assert asked == (not remote or stop is not RequestedStop.NONE)


def test_a_state_lasts_as_long_as_its_source_says_and_the_text_names_it(plane_arm: Monitored) -> None:
    rules = dataclasses.replace(RULES, notes={Reason.STATE_ABSENT: "awaited: status"})
    guard = Guard(plane_arm, rules, RequestedStop.NONE)
    assert "no robot state has arrived (awaited: status)" in guard.decide(0.0).text
    guard.on_status(GOOD, 0.0, 2.5, "kss_message_handler/status")
    assert Reason.STATE_STALE not in guard.decide(2.5).reasons
    late = guard.decide(2.6)
    assert Reason.STATE_STALE in late.reasons
    assert "the robot state is out of date (kss_message_handler/status: 2.6 s, at most 2.5 s)" in late.text


def test_a_clock_that_goes_back_leaves_joint_states_present(plane_arm: Monitored) -> None:
    guard, now = permitting(plane_arm)
    guard.on_joints(np.zeros(3), now + 0.01, now - 1.0)
    assert Reason.SPEED_UNKNOWN in guard.decide(now + 0.01).reasons
