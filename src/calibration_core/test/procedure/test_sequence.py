"""The procedure under every order of events: what it must never do, and that it always comes to an end.

The world in `conftest.py` knows the rules (no motion without permission, in a pause, or under load; no reading before
arrival and standstill, ...) and fails as soon as one is broken.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from calibration_core.measurement import messages as m
from calibration_core.measurement.messages import Kind, Outcome, RunState
from calibration_core.measurement.sequence import Sequence
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import Plan
from calibration_core.timeseries import Phase

Started, Plans = Callable[..., Any], Callable[..., Plan]
LEVELS = np.array([0.0, 500.0, 1000.0, 0.0])
RULES = SequenceRules(startup_period=500.0)

ACTIONS = st.sampled_from(
    ["answer"] * 12
    + ["fail"] * 2
    + [
        "loss",
        "gain",
        "gain",
        "pause",
        "resume",
        "resume_motion",
        "resume_motion",
        "repeat",
        "skip",
        "repeat_after_load",
        "skip_after_load",
        "tick",
        "wait",
        "stale",
        "late",
        "heard",
        "unheard",
        "pulls",
    ]
)
LATE = ["gain", *["answer"] * 4, "loss", "wait", "answer"]


@example(  # a reading of the reference reaches the disk after it was given up
    actions=LATE, end="run", attempts=1, readings=1, final_load=False, loaded=False
)
@example(actions=LATE, end="run", attempts=2, readings=1, final_load=False, loaded=False)
@settings(max_examples=1500, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    actions=st.lists(ACTIONS, max_size=150),
    end=st.sampled_from(["run", "run", "run", "stop", "fault"]),
    attempts=st.integers(1, 3),
    readings=st.integers(1, 3),
    final_load=st.booleans(),
    loaded=st.booleans(),
)
def test_rules_hold_and_it_ends(
    started: Started,
    plan_of: Plans,
    actions: list[str],
    end: str,
    attempts: int,
    readings: int,
    final_load: bool,
    loaded: bool,
) -> None:
    rules = dataclasses.replace(RULES, attempts=attempts, readings=readings)
    world = started(plan_of(LEVELS[:3] if final_load else LEVELS), rules=rules, loaded=loaded)
    for action in actions:
        world.act(action)
        share = world.sequence.queue.share_done
        assert 0.0 <= share <= 1.0
    if end == "run":
        finish = world.run()
        if finish.outcome is Outcome.COMPLETED:
            assert len(world.completed) == 4
        elif finish.outcome is Outcome.INCOMPLETE:
            assert len(world.completed) < 4
            assert len(world.sequence.queue.given_up) == 6 - len(world.completed)
    else:
        world.act(end)
    assert world.finish is not None
    assert sorted(world.completed) == sorted(world.sequence.queue.completed)
    assert len(set(world.completed)) == len(world.completed)
    assert world.visits == sorted(set(world.visits))  # every visit of the reference has its own step
    for steps in world.confirmed.values():
        assert steps == list(range(len(steps)))  # no step twice, none left out
    world.act("gain")
    world.act("tick")  # nothing follows


def test_a_good_day(started: Started) -> None:
    world = started()
    assert world.run().outcome is Outcome.COMPLETED
    assert world.completed == [1, 2, 3, 4]
    assert world.visits == [0, 1, 2]  # at the beginning, after two, at the end
    assert [record.kind for record in world.records if record.kind is Kind.WARM_UP] == [Kind.WARM_UP] * 2
    of_two = [(mark.step, mark.phase) for mark in world.marks if mark.configuration == 2]
    assert of_two == [
        (0, Phase.MOVING), (0, Phase.SETTLING), (0, Phase.MEASURING),
        (1, Phase.LOADING), (1, Phase.SETTLING), (1, Phase.MEASURING),
        (2, Phase.LOADING), (2, Phase.SETTLING), (2, Phase.MEASURING),
        (3, Phase.UNLOADING), (3, Phase.SETTLING), (3, Phase.MEASURING), (3, Phase.DONE),
    ]  # fmt: skip
    assert world.sequence.queue.share_done == 1.0
    assert world.sequence.seconds_left == 0.0


def test_blocked_configurations_are_retried_and_replaced_by_spares(started: Started) -> None:
    world = started()
    world.act("gain")
    while world.finish is None:
        blocked = isinstance(world.asked, m.Move) and world.asked.configuration == 2 and world.attempt is not None
        world.act("fail" if blocked else "answer" if world.asked else "tick")
    assert world.attempts[2] == RULES.attempts - 1
    assert world.completed == [1, 3, 4, 5]
    assert world.sequence.queue.given_up == {2}
    assert any(record.kind is Kind.SPARE_USED and "in place of 2" in record.text for record in world.records)
    assert world.finish.outcome is Outcome.COMPLETED


@pytest.mark.parametrize("where", [m.Move, m.RequestLoad, m.AwaitSettled, m.TakeReading])
def test_the_operator_has_a_configuration_measured_again(started: Started, where: type[m.Command]) -> None:
    """As often as she wants: that counts for no failure, and nothing is measured twice."""
    world = started()
    world.act("gain")
    wishes = 0
    while world.finish is None:
        here = isinstance(world.asked, where) and world.attempt is not None and world.attempt.configuration == 2
        if here and not world.sequence._given_up_for and wishes < 5:
            world.act("repeat")
            wishes += 1
        else:
            world.act("answer" if world.asked else "tick")
    assert wishes == 5
    assert world.attempts[2] == 5
    assert world.completed == [1, 2, 3, 4]
    assert world.finish.outcome is Outcome.COMPLETED


@pytest.mark.parametrize("where", [m.Move, m.RequestLoad, m.AwaitSettled, m.TakeReading])
@pytest.mark.parametrize("action", ["skip", "skip_after_load"])
def test_the_operator_has_a_configuration_left_out(started: Started, where: type[m.Command], action: str) -> None:
    world = started()
    world.act("gain")
    while world.finish is None:
        here = isinstance(world.asked, where) and world.attempt is not None and world.attempt.configuration == 2
        world.act(action if here and not world.sequence._given_up_for else "answer" if world.asked else "tick")
    assert world.completed == [1, 3, 4, 5]
    assert world.attempts[2] == 0
    assert world.sequence.queue.given_up == {2}
    assert np.array_equal(world.load, np.zeros(6))


def test_a_load_that_another_run_may_have_left_is_released_before_anything_moves(started: Started) -> None:
    """Without permission to move, too; the robot does not move on a load that cannot be released."""
    world = started(loaded=True)
    asked = world.asked
    assert isinstance(asked, m.RequestLoad)
    assert (asked.unknown, asked.wrench.any()) == (True, False)
    world.act("answer")
    world.act("gain")
    assert isinstance(world.asked, m.Move)
    assert world.run().outcome is Outcome.COMPLETED
    stuck = started(loaded=True)
    stuck.act("fail")
    assert stuck.finish.outcome is Outcome.FAULT
    assert stuck.finish.text == "the load cannot be released: no air"


def test_what_the_sensor_tells_of_is_released_before_a_motion_begins(started: Started) -> None:
    """While the motion is waited for, and once it was commanded: in both cases nothing has moved yet."""
    for commanded in (False, True):
        world = started()
        if commanded:
            world.act("gain")
            assert isinstance(world.asked, m.Move)
        world.act("pulls")
        assert isinstance(world.asked, m.RequestLoad)
        assert world.asked.unknown
        world.act("answer")
        assert world.run().outcome is Outcome.COMPLETED


def test_when_the_spares_are_used_up(started: Started) -> None:
    world = started()
    world.act("gain")
    while world.finish is None:
        world.act("fail" if isinstance(world.asked, m.Move) and world.attempt is not None else "answer")
    assert world.finish.outcome is Outcome.INCOMPLETE
    assert world.sequence.queue.given_up == {1, 2, 3, 4, 5, 6}


def test_loss_of_permission_while_moving_needs_the_operator(started: Started) -> None:
    world = started()
    world.act("gain")
    assert isinstance(world.asked, m.Move)
    target = world.asked.q
    commands = world.sequence.handle(m.PermissionChanged(5.0, False, "mode"))
    assert any(isinstance(command, m.StopMotion) for command in commands)
    assert any(isinstance(command, m.AskOperator) for command in commands)
    assert not any(isinstance(c, m.Move) for c in world.sequence.handle(m.PermissionChanged(6.0, True)))
    assert not any(isinstance(c, m.Move) for c in world.sequence.handle(m.Tick(7.0)))
    assert world.sequence.held
    assert world.sequence.handle(m.Resume(7.5)) == ()  # which is for a pause
    again = world.sequence.handle(m.ResumeMotion(8.0, "A. Smith"))
    assert not world.sequence.held
    assert any(isinstance(c, m.Record) and c.text == "by A. Smith" for c in again)
    assert np.array_equal(next(c for c in again if isinstance(c, m.Move)).q, target)


def test_started_without_permission_it_waits_for_the_operator(plan_of: Plans) -> None:
    """Neither a reset of the guard nor drives that are switched on set the robot in motion."""
    sequence = Sequence(plan_of(), RULES)
    said = [*sequence.handle(m.Start(0.0, held=True)), *sequence.handle(m.GuardHearing(0.0, True))]
    for event in (m.PermissionChanged(1.0, True), m.Tick(2.0), m.Resume(3.0), m.PermissionChanged(4.0, False)):
        said += sequence.handle(event)
    said += sequence.handle(m.PermissionChanged(5.0, True))
    assert not any(isinstance(command, m.Move) for command in said)
    assert any(isinstance(c, m.Move) for c in sequence.handle(m.ResumeMotion(6.0, "A. Smith")))


def moves(sequence: Sequence, *events: m.Event) -> bool:
    """Tell what happens; return whether a motion was commanded."""
    return any(isinstance(command, m.Move) for event in events for command in sequence.handle(event))


def test_motion_is_not_resumed_in_advance(plan_of: Plans) -> None:
    """The permission goes between the operator's word and its taking: a later reset alone moves nothing."""
    sequence = Sequence(plan_of(), RULES)
    heard = m.GuardHearing(0.0, True)
    assert moves(sequence, m.Start(0.0), heard, m.PermissionChanged(1.0, True))
    assert not moves(sequence, m.PermissionChanged(2.0, False, "stale", ready=False))
    assert not moves(sequence, m.ResumeMotion(3.0, "A. Smith"))
    assert not moves(sequence, m.PermissionChanged(4.0, True), m.Tick(5.0))
    assert sequence.held
    assert moves(sequence, m.ResumeMotion(6.0, "A. Smith"))


def test_what_speaks_against_motion_before_the_first_one_is_for_the_operator(plan_of: Plans) -> None:
    """A missing proof is waited for; after anything else, motion is resumed by name, though none was under way."""
    sequence = Sequence(plan_of(), RULES)
    assert not moves(sequence, m.Start(0.0), m.GuardHearing(0.0, True), m.PermissionChanged(1.0, False, "unproven"))
    assert not sequence.held
    assert not moves(sequence, m.PermissionChanged(2.0, False, "the drives are off", ready=False))
    assert not moves(sequence, m.PermissionChanged(3.0, False, "unproven"), m.PermissionChanged(4.0, True))
    assert not moves(sequence, m.Resume(5.0))
    assert moves(sequence, m.ResumeMotion(6.0, "A. Smith"))


def test_no_motion_begins_before_the_guard_hears(started: Started) -> None:
    world = started()
    world.act("unheard")
    world.act("gain")
    assert world.asked is None
    assert world.records[-1].text == "the guard does not hear the sequencer yet"
    world.act("heard")
    assert isinstance(world.asked, m.Move)
    target = world.asked
    world.act("unheard")
    assert world.asked is target, "a motion under way is the guard's to stop"
    world.act("answer")
    while not (world.asked is None or isinstance(world.asked, m.Move)):
        world.act("answer")
    assert world.asked is None
    for action in ("tick", "resume"):
        world.act(action)
        assert world.asked is None
    world.act("heard")
    assert isinstance(world.asked, m.Move)


def test_reading_under_way_survives_a_pause_and_a_loss(started: Started) -> None:
    world = started()
    world.act("gain")
    while not (isinstance(world.asked, m.TakeReading) and world.asked.configuration == 1):
        world.act("answer")
    world.act("pause")
    world.act("loss")
    world.act("answer")
    assert world.confirmed == {(1, 0): [0]}
    assert world.asked is None
    assert world.sequence.state is RunState.READY
    world.act("resume")
    assert world.asked is None
    world.act("resume_motion")
    assert isinstance(world.asked, m.RequestLoad)  # a change of load is no motion


def test_a_load_that_cannot_be_released_ends_it(started: Started) -> None:
    world = started()
    world.act("gain")
    while not (isinstance(world.asked, m.RequestLoad) and world.asked.step == 3):
        world.act("answer")
    world.act("fail")  # the step that takes the load off fails: release is asked for, and fails as well
    assert isinstance(world.asked, m.RequestLoad)
    world.act("fail")
    assert world.finish is not None
    assert world.finish.outcome is Outcome.FAULT


def test_late_confirmation_counts(started: Started) -> None:
    world = started()
    world.act("gain")
    while not (isinstance(world.asked, m.TakeReading) and world.asked.configuration == 1):
        world.act("answer")
    old = world.asked
    world.act("wait")
    assert isinstance(world.asked, m.AwaitSettled)
    world.late()
    assert world.confirmed == {(1, 0): [old.step]}
    assert isinstance(world.asked, m.RequestLoad)


def test_confirmation_after_the_attempt_was_given_up_does_not_count(started: Started) -> None:
    world = started(rules=dataclasses.replace(RULES, readings=1))
    world.act("gain")
    while not (isinstance(world.asked, m.TakeReading) and world.asked.configuration == 1):
        world.act("answer")
    old = world.asked
    world.act("wait")  # the reading takes too long: the attempt is over, the next one begins
    assert isinstance(world.asked, m.Move)
    assert world.sequence.handle(m.ReadingConfirmed(world.now, old.request)) == ()
    assert world.run().outcome is Outcome.COMPLETED
    assert world.confirmed[1, 1] == [0, 1, 2, 3]


def test_answers_to_an_interrupted_motion_are_out_of_date(started: Started) -> None:
    world = started()
    world.act("gain")
    old = world.asked.request
    world.act("loss")
    world.act("gain")
    world.act("resume_motion")
    assert world.asked.request != old
    assert world.sequence.handle(m.Arrived(world.now, old)) == ()
    assert world.sequence.handle(m.Blocked(world.now, old, "stopped")) == ()
    assert world.sequence.state is RunState.MOVING


def test_resume_continues_at_the_next_configuration(started: Started) -> None:
    world = started(completed=frozenset({1, 2}), given_up=frozenset({3}), visits=2)
    assert world.records[0].kind is Kind.RESUMED
    world.run()
    assert world.completed == [4, 5]
    assert world.visits == [2, 3]
    assert world.sequence.queue.completed == {1, 2, 4, 5}


def test_resume_of_what_is_complete(started: Started) -> None:
    world = started(completed=frozenset({1, 2, 3, 4}))
    assert world.finish is not None
    assert world.finish.outcome is Outcome.COMPLETED


def test_startup_cycle_is_repeated_periodically(started: Started) -> None:
    world = started(rules=dataclasses.replace(RULES, startup_period=20.0, startup_cycles=2))
    world.run()
    warm = [i for i, record in enumerate(world.records) if record.kind is Kind.WARM_UP]
    first = next(i for i, record in enumerate(world.records) if record.kind is Kind.CONFIGURATION_STARTED)
    assert len([i for i in warm if i < first]) == 4
    assert len([i for i in warm if i > first]) >= 2


def test_stop_with_the_load_on_says_so(started: Started) -> None:
    world = started()
    world.act("gain")
    while not (isinstance(world.asked, m.TakeReading) and world.asked.step == 1):
        world.act("answer")
    commands = world.sequence.handle(m.Stop(99.0))
    assert any(isinstance(command, m.AskOperator) and "load" in command.text for command in commands)
    assert isinstance(commands[-1], m.Finish)
    assert commands[-1].outcome is Outcome.STOPPED


def test_plan_without_reference_and_startup(started: Started, plan_of: Plans) -> None:
    world = started(dataclasses.replace(plan_of(), reference=None, startup_cycle=np.empty((0, 3))))
    assert world.run().outcome is Outcome.COMPLETED
    assert world.visits == []
