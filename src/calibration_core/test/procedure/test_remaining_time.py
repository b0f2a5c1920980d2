"""The time left: what the plan expects, at the pace of what is done, whatever waiting and pauses take."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from calibration_core.measurement import messages as m
from calibration_core.planning.plans.plan import Expected, Plan

Started, Plans = Callable[..., Any], Callable[..., Plan]
TOTAL = 600.0  # s, that the plan expects
COUNT = 10  # configurations


def expecting(plan: Plan, **duration: float) -> Plan:
    """Return the plan with what it expects of its duration."""
    expected = Expected(None, 1.0, np.ones(3), None, None, None, 0.1, 0.0, 0, duration=duration)
    return dataclasses.replace(plan, expected=expected)


@pytest.fixture
def world(started: Started, plan_of: Plans) -> Any:
    """A run of ten configurations that the plan expects to take ten minutes; everything takes 1 s."""
    return started(expecting(plan_of(count=COUNT, spares=0), total=TOTAL))


def left(world: Any) -> float:
    return float(world.sequence.seconds_left)


def go_on(world: Any, done: int, each: float = 0.0) -> None:
    """Measure until some configurations are done; everything takes `each` seconds longer."""
    while len(world.completed) < done:
        world.now += each if world.asked else 0.0
        world.act("answer" if world.asked else "tick")


def wait(world: Any, *, polls: int = 10) -> list[float]:
    """Let time pass in which nothing is done; return the time left as it was reported meanwhile."""
    reported = []
    for _ in range(polls):
        world.now += 30.0
        world.tell(m.PermissionChanged(world.now, world.permitted))
        reported.append(left(world))
    return reported


def test_what_the_plan_expects_is_told_before_anything_is_done(world: Any) -> None:
    assert left(world) == pytest.approx(TOTAL)
    assert wait(world) == pytest.approx([TOTAL] * 10)  # for the permission
    world.act("gain")
    assert left(world) == pytest.approx(TOTAL)


def test_it_becomes_less_and_is_nothing_at_the_end(world: Any) -> None:
    world.act("gain")
    seen = [left(world)]
    go_on(world, 1)
    assert left(world) < 0.95 * TOTAL  # one of ten says little of the pace yet
    assert left(world) > 0.8 * TOTAL
    while world.finish is None:
        world.act("answer" if world.asked else "tick")
        seen.append(left(world))
    steps = [after - before for before, after in itertools.pairwise(seen)]
    assert max(steps) <= 1e-9
    assert seen[-1] == 0.0


def test_it_follows_how_long_what_is_done_took(started: Started, plan_of: Plans) -> None:
    found = {}
    for each in (0.0, 9.0):
        world = started(expecting(plan_of(count=COUNT, spares=0), total=TOTAL))
        world.act("gain")
        go_on(world, COUNT // 2, each)
        reported, since = left(world), world.now
        go_on(world, COUNT, each)
        found[each] = reported
        assert reported == pytest.approx(world.now - since, rel=0.2)
    assert found[9.0] == pytest.approx(10.0 * found[0.0], rel=0.05)  # its start-up cycle is repeated


@pytest.mark.parametrize(
    ("begin", "end"), [(["pause"], ["resume"]), (["loss"], ["gain", "resume_motion"]), (["unheard"], ["heard"])]
)
@pytest.mark.parametrize("answers", range(8))
def test_pauses_and_waiting_change_nothing(world: Any, begin: list[str], end: list[str], answers: int) -> None:
    world.act("gain")
    go_on(world, COUNT // 2)
    for _ in range(answers):
        world.act("answer")
    for action in begin:
        world.act(action)
    while world.asked is not None:  # what was begun ends in the pause
        world.act("answer")
    before, reported = left(world), wait(world)
    assert reported == [before] * len(reported)
    for action in end:
        world.act(action)
    go_on(world, len(world.completed) + 1)
    assert left(world) < before


def test_after_a_stop_nothing_is_left(world: Any) -> None:
    world.act("gain")
    go_on(world, 3)
    world.act("stop")
    assert left(world) == 0.0


def test_where_it_is_enough_only_what_is_under_way_is_left(world: Any) -> None:
    world.act("gain")
    go_on(world, 5)
    each = left(world) / 5
    world.act("answer")
    world.tell(m.Enough(world.now, "enough"))
    assert left(world) == pytest.approx(each, rel=0.1)


def test_a_run_that_is_resumed_expects_its_share(started: Started, plan_of: Plans) -> None:
    plan = expecting(plan_of(count=COUNT, spares=0), total=TOTAL)
    world = started(plan, completed=frozenset(range(1, 6)), visits=3)
    assert left(world) == pytest.approx(0.5 * TOTAL, rel=0.1)


@pytest.mark.parametrize("duration", [{}, {"total": 0.0}, {"total": math.inf}, {"total": -1.0}, {"moving": 9.0}])
def test_a_plan_that_expects_nothing_is_told_once_enough_is_done(
    started: Started, plan_of: Plans, duration: dict[str, float]
) -> None:
    world = started(expecting(plan_of(count=COUNT, spares=0), **duration))
    world.act("gain")
    go_on(world, 1)
    assert math.isnan(left(world))
    go_on(world, COUNT // 2)
    reported, since = left(world), world.now
    go_on(world, COUNT)
    assert reported == pytest.approx(world.now - since, rel=0.2)
