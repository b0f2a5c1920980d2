"""The proof that the guard can stop the robot: what counts, and what does not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.motion.guard import Guard, GuardRules
from calibration_core.motion.robot_status import Drives, OperatingMode, Reason, RobotStatus, SafetyState
from calibration_core.motion.speed import Monitored
from calibration_core.motion.stop_proof import RequestedStop, StopProof

GOOD = RobotStatus(OperatingMode.MANUAL_REDUCED, Drives.ON, SafetyState.NORMAL, True, False, False, 1.0)
Q = np.array([0.1, 0.2, 0.3])


def tried(
    stop: RequestedStop = RequestedStop.CANCEL,
    *,
    answers_after: float = 0.1,
    cancelled: bool = True,
    moves: float = 0.0,
    heard_until: float = 9.0,
    against_at: float = 9.0,
    ends_at: float = 9.0,
) -> tuple[StopProof, float]:
    """Go through a proof, 100 steps a second; return it and when the robot was stopped."""
    proof, stopped = StopProof(stop), float("nan")
    proof.begin(0.0)
    for now in np.arange(0.0, 3.0, 0.01):
        if now < heard_until:
            proof.on_joints(Q + moves * (now > 0.15) * np.eye(3)[1], now)
        if now >= ends_at:
            proof.on_ended(now, cancelled=False)
        if now >= stopped + answers_after:
            proof.on_ended(now, cancelled=cancelled)
            answers_after = np.inf
        if proof.step(now, "the drives are off" if now >= against_at else ""):
            stopped = float(now)
    return proof, stopped


def test_what_counts() -> None:
    proof, stopped = tried()
    assert (proof.proven, proof.running, proof.text) == (True, False, "")
    assert stopped == pytest.approx(0.2, abs=0.011)
    proof.begin(5.0)
    assert not proof.proven  # each one anew


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"answers_after": 0.55}, "not cancelled within 0.5 s"),
        ({"answers_after": 9.0}, "not cancelled within 0.5 s"),
        ({"cancelled": False}, "did not end as cancelled"),
        ({"ends_at": 0.1}, "ended before it was cancelled"),
        ({"moves": 1.1e-4}, "a joint moved by 0.11 mrad"),
        ({"moves": -0.01}, "a joint moved by 10 mrad"),
        ({"heard_until": 0.0}, "no joint states have arrived"),
        ({"heard_until": 0.1}, "no joint states arrived after the stop"),
        ({"against_at": 0.4}, "the drives are off"),
    ],
)
def test_what_does_not_count(how: dict[str, float], text: str) -> None:
    proof, _ = tried(**how)  # type: ignore[arg-type]
    assert not proof.proven
    assert not proof.running
    assert text in proof.text


def test_noise_of_encoders_is_no_motion() -> None:
    assert tried(moves=0.9e-4)[0].proven


def test_a_held_position_ends_without_a_word() -> None:
    assert tried(RequestedStop.HOLD, answers_after=9.0)[0].proven
    assert not tried(RequestedStop.HOLD, answers_after=9.0, moves=2e-4)[0].proven


def test_where_only_the_pendant_stops_nothing_is_to_be_proven() -> None:
    proof = StopProof(RequestedStop.NONE)
    proof.begin(0.0)
    proof.void("never mind")
    assert proof.proven
    assert not proof.running


def alive(guard: Guard, begin: float, end: float, q: np.ndarray = Q, status: RobotStatus = GOOD) -> list[float]:
    """Let a guard live; return when it wanted the robot to be stopped."""
    stops = []
    for now in np.arange(begin, end, 0.01):
        guard.on_status(status, now)
        guard.on_joints(q, now, now)
        if guard.prove(guard.decide(now)):
            stops.append(float(now))
            guard.proof.on_ended(now, cancelled=True)
    return stops


def test_no_motion_before_the_proof(plane_arm: Monitored) -> None:
    guard = Guard(plane_arm, GuardRules(), RequestedStop.CANCEL)
    alive(guard, 0.0, 0.5)
    decision = guard.decide(0.5)
    assert (decision.reasons, decision.latched) == ((Reason.STOP_UNPROVEN,), ())
    assert "not tried yet" in decision.text
    guard.proof.begin(0.5)
    assert len(alive(guard, 0.5, 1.5, status=dataclasses.replace(GOOD, in_motion=True))) == 1
    assert guard.proof.proven  # the driver says that it moves where it is held: joint states that repeat are no fault
    alive(guard, 1.5, 1.6)
    assert guard.decide(1.6).permitted


def test_a_proof_ends_with_what_it_rests_on(plane_arm: Monitored) -> None:
    guard = Guard(plane_arm, GuardRules(), RequestedStop.CANCEL)
    alive(guard, 0.0, 0.1)
    guard.proof.begin(0.1)
    alive(guard, 0.1, 1.0)
    assert guard.decide(1.0).permitted
    guard.on_joints(Q, 3.0, 3.0)  # nothing came for two seconds
    for now in np.arange(1.1, 3.1, 0.1):
        guard.decide(now)
    assert Reason.STOP_UNPROVEN in guard.decide(3.1).reasons
    alive(guard, 3.1, 3.2)
    reset = guard.reset(3.2)
    assert (reset.reasons, reset.latched) == ((Reason.STOP_UNPROVEN,), ())  # it clears, and permits nothing
    guard.proof.begin(3.2)
    alive(guard, 3.2, 3.3)
    alive(guard, 3.3, 3.5, status=dataclasses.replace(GOOD, drives=Drives.OFF))
    alive(guard, 3.5, 4.5)
    assert "drives" in guard.proof.text
    assert not guard.decide(4.5).permitted


@pytest.mark.parametrize(
    ("tell", "reason"),
    [(Guard.on_silence, Reason.SEQUENCER_SILENT), (Guard.on_second_guard, Reason.TWO_GUARDS)],
)
def test_what_is_latched_at_once(plane_arm: Monitored, tell, reason: Reason) -> None:
    guard = Guard(plane_arm, GuardRules(), RequestedStop.NONE)
    alive(guard, 0.0, 0.1)
    tell(guard)
    assert guard.decide(0.1).latched == (reason,)
    assert guard.decide(0.11).reasons == (Reason.LATCHED,)
    assert guard.reset(0.12).permitted


def test_two_that_publish_the_same_are_named(plane_arm: Monitored) -> None:
    guard = Guard(plane_arm, GuardRules(), RequestedStop.NONE)
    alive(guard, 0.0, 0.1)
    guard.on_sources("/joint_states: /driver, /replay")
    assert "/joint_states: /driver, /replay" in guard.decide(0.1).text
    assert Reason.LATCHED in guard.reset(0.11).reasons
    guard.on_sources("")
    assert guard.reset(0.12).permitted


@pytest.mark.parametrize(
    ("moved", "tracking", "proven"), [(5e-4, 0.0, False), (5e-4, 2.5e-4, True), (7e-4, 2.5e-4, False)]
)
def test_a_joint_that_lies_beside_its_command_may_go_to_where_it_is_held(
    plane_arm: Monitored, moved: float, tracking: float, proven: bool
) -> None:
    """A driver sends it where it is measured, and holds it where it is measured then: it goes by twice its error."""
    guard = Guard(plane_arm, GuardRules(tracking_error=tracking), RequestedStop.HOLD)
    proof = guard.proof
    proof.begin(0.0)
    for now in np.arange(0.0, 1.0, 0.01):
        proof.on_joints(Q + moved * (now > 0.25) * np.eye(3)[1], now)
        proof.step(float(now), "")
    assert proof.proven == proven
    assert proven or "a joint moved by" in proof.text
    assert proven or f"{1e3 * (1e-4 + 2.0 * tracking):.3g} is its bound" in proof.text
