"""The guard's rules, one at a time."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.motion.guard import Guard, GuardRules
from calibration_core.motion.robot_status import TEXT, Drives, OperatingMode, Reason, RobotStatus, SafetyState
from calibration_core.motion.speed import Monitored
from calibration_core.motion.stop_proof import RequestedStop

GOOD = RobotStatus(OperatingMode.MANUAL_REDUCED, Drives.ON, SafetyState.NORMAL, True, False, False, 1.0)
RULES = GuardRules()
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
        assert decision.permitted == (0.02 * i <= RULES.max_state_age + 1e-9)
    assert decision.latched == (Reason.STATE_STALE,)


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


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_over_speed_is_measured(demo_cell: Cell, rate: float) -> None:
    """A turn of joint 1: the farthest point's speed is its distance from the axis times the rate."""
    chain = chain_of(demo_cell)
    monitored = Monitored.of(chain, nominal_parameters(demo_cell), None)
    guard, q, now = Guard(monitored, RULES, RequestedStop.NONE), np.array([0.0, 0.2, -0.3, 0.1, 0.8, 0.0]), 0.0
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
    assert guard.decide(now, 0.25).permitted


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
    assert "a joint state is missing or not a finite number" in text


def test_a_clock_that_goes_back_leaves_joint_states_present(plane_arm: Monitored) -> None:
    guard, now = permitting(plane_arm)
    guard.on_joints(np.zeros(3), now + 0.01, now - 1.0)
    assert Reason.SPEED_UNKNOWN in guard.decide(now + 0.01).reasons
