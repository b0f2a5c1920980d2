"""The manager's bookkeeping: up in order, down in the opposite one, whoever is silent is missed, not waited for."""

from __future__ import annotations

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration.lifecycle import machine
from calibration.lifecycle.machine import ACTIVATE, ACTIVE, CLEANUP, CONFIGURE, DEACTIVATE, INACTIVE, UNCONFIGURED
from calibration.lifecycle.order import PATIENCE, RETRY, Order

NAMES = ("guard", "tracker", "sequencer")
LEASE = 1.5


@pytest.fixture
def order() -> Order:
    return Order(NAMES, LEASE, 0.0)


def hear(order: Order, now: float = 0.0, **states: int) -> None:
    for name, state in states.items():
        order.hear(name, 10 + NAMES.index(name), state, now)


def walk(order: Order, now: float = 0.0) -> list[tuple[str, int]]:
    """Do what is to be done next, at once, until there is nothing."""
    done: list[tuple[str, int]] = []
    goals = {CONFIGURE: INACTIVE, ACTIVATE: ACTIVE, DEACTIVATE: INACTIVE, CLEANUP: UNCONFIGURED}
    while (step := order.next(now)) is not None:
        done.append(step)
        order.hear(step[0], order.members[step[0]].process, goals[step[1]], now)
        assert len(done) < 20
    return done


def test_up_in_order_and_down_in_the_opposite_one(order: Order) -> None:
    assert order.next(0.0) is None  # nobody is heard yet
    hear(order, sequencer=UNCONFIGURED, tracker=UNCONFIGURED)
    assert order.next(0.0) is None  # the guard may still come
    hear(order, guard=UNCONFIGURED)
    up = walk(order)
    assert up == [(name, transition) for name in NAMES for transition in (CONFIGURE, ACTIVATE)]
    assert order.all_active
    order.bring(up=False)
    down = walk(order)
    assert down == [(name, transition) for name in reversed(NAMES) for transition in (DEACTIVATE, CLEANUP)]
    assert order.all_down
    order.bring(up=True)
    assert walk(order) == up


def test_what_is_active_by_itself_is_left_so(order: Order) -> None:
    hear(order, guard=ACTIVE, tracker=ACTIVE, sequencer=ACTIVE)
    assert order.next(0.0) is None
    assert order.all_active


def test_what_an_operator_deactivates_is_left_so(order: Order) -> None:
    hear(order, guard=UNCONFIGURED, tracker=UNCONFIGURED, sequencer=UNCONFIGURED)
    walk(order)
    hear(order, 1.0, tracker=INACTIVE)
    assert order.next(1.0) is None
    hear(order, 2.0, tracker=UNCONFIGURED)
    assert order.next(2.0) is None


def test_a_node_that_comes_back_as_another_process_is_brought_up(order: Order) -> None:
    hear(order, guard=UNCONFIGURED, tracker=UNCONFIGURED, sequencer=UNCONFIGURED)
    walk(order)
    assert not order.hear("tracker", 11, ACTIVE, 1.0)
    assert order.lose("tracker", 1.0)
    assert not order.lose("tracker", 1.0)
    assert not order.all_active
    assert order.hear("tracker", 99, UNCONFIGURED, 2.0)
    assert walk(order, 2.0) == [("tracker", CONFIGURE), ("tracker", ACTIVATE)]


def test_who_stays_away_is_waited_for_a_while_only(order: Order) -> None:
    hear(order, guard=UNCONFIGURED, sequencer=UNCONFIGURED)
    assert walk(order, 1.0) == [("guard", CONFIGURE), ("guard", ACTIVATE)]
    later = PATIENCE + 0.1
    order.hear("sequencer", 12, UNCONFIGURED, later)
    assert walk(order, later) == [("sequencer", CONFIGURE), ("sequencer", ACTIVATE)]


def test_silence_is_noticed_once_and_ends(order: Order) -> None:
    hear(order, guard=ACTIVE, tracker=ACTIVE, sequencer=ACTIVE)
    assert order.silent(LEASE) == []
    hear(order, LEASE, guard=ACTIVE, sequencer=ACTIVE)
    assert order.silent(LEASE + 0.1) == ["tracker"]
    assert order.silent(LEASE + 0.2) == []
    assert order.hear("tracker", 11, ACTIVE, LEASE + 0.3)  # it was stopped, and goes on
    assert order.all_active


def test_a_node_that_is_being_brought_up_is_given_time(order: Order) -> None:
    hear(order, guard=machine.CONFIGURING, tracker=machine.ACTIVATING, sequencer=UNCONFIGURED)
    order.silent(LEASE)
    assert not order.lose("guard", 2.0 * LEASE)
    assert order.silent(LEASE + 0.1) == []  # nobody says that the guard is silent while everything is starting
    order.silent(PATIENCE)
    assert order.silent(PATIENCE + 0.1) == ["guard", "tracker", "sequencer"]
    hear(order, PATIENCE + 0.2, guard=ACTIVE, tracker=ACTIVE, sequencer=ACTIVE)
    order.silent(PATIENCE + LEASE)
    assert order.silent(PATIENCE + 0.3 + LEASE) == ["guard", "tracker", "sequencer"]  # they have been up


def test_a_manager_that_was_busy_itself_hears_the_others_before_it_misses_them(order: Order) -> None:
    hear(order, guard=ACTIVE, tracker=ACTIVE, sequencer=ACTIVE)
    assert order.silent(0.1) == []
    assert order.silent(4.0) == []
    hear(order, 4.0, guard=ACTIVE, sequencer=ACTIVE)
    assert order.silent(4.1) == ["tracker"]


def test_what_fails_is_tried_again_later_and_holds_nobody_up(order: Order) -> None:
    hear(order, guard=UNCONFIGURED, tracker=UNCONFIGURED, sequencer=UNCONFIGURED)
    assert order.next(1.0) == ("guard", CONFIGURE)
    order.fail("guard", 1.0)
    assert order.next(1.0) == ("tracker", CONFIGURE)
    assert order.next(1.0 + RETRY) == ("guard", CONFIGURE)


def test_a_guard_that_does_not_go_down_keeps_nothing_else_up_and_is_asked_again(order: Order) -> None:
    hear(order, guard=ACTIVE, tracker=ACTIVE, sequencer=ACTIVE)
    order.bring(up=False)
    assert order.next(1.0) == ("sequencer", DEACTIVATE)
    order.fail("sequencer", 1.0)
    assert order.next(1.1) is None  # the guard does not go while the sequencer is active
    assert order.next(1.0 + RETRY) == ("sequencer", DEACTIVATE)


def test_a_transition_under_way_is_waited_for(order: Order) -> None:
    hear(order, guard=machine.CONFIGURING, tracker=UNCONFIGURED, sequencer=UNCONFIGURED)
    assert order.next(0.0) is None
