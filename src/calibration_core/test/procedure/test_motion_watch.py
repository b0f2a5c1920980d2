"""Whose sign of life counts, and which motion is stopped: every case of a sequencer, its successor and a stranger."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration_core.motion.motion_watch import AGAIN, FORBIDDEN, MOVES, REPORTED, SILENT, UNHEARD, MotionWatch

AGE, OURS, OTHER = 0.1, 7, 8
FAST, SLOW = 2.0 * MOVES, 0.5 * MOVES


def following(*, moving: bool = False, can_stop: bool = True, until: float = 1.0, speed: float = 0.0) -> MotionWatch:
    """Return a guard's watch over a sequencer that has spoken 50 times a second, last at `until` s."""
    watch = MotionWatch(AGE, can_stop=can_stop)
    for count in range(50):
        now = until - 0.02 * (49 - count)
        watch.on_pulse(OURS, count, now, moving=moving)
        assert watch.fault(now, permitted=True, speed=speed) == ""
    return watch


@pytest.mark.parametrize(
    ("moving", "permitted", "after", "speed", "can_stop", "fault"),
    [
        (False, True, 0.0, FAST, True, ""),  # heard and not moving: who moves the robot is the operator's affair
        (False, False, 0.0, FAST, True, ""),
        (False, True, 2 * AGE, SLOW, True, ""),
        (False, True, 2 * AGE, math.nan, True, ""),
        (False, True, 2 * AGE, FAST, True, UNHEARD),
        (False, False, 2 * AGE, FAST, True, UNHEARD),
        (False, True, 2 * AGE, FAST, False, ""),  # moved by the hand on the pendant
        (True, True, 0.5 * AGE, FAST, True, ""),
        (True, False, 0.5 * AGE, FAST, True, FORBIDDEN),
        (True, False, 0.5 * AGE, math.nan, True, FORBIDDEN),
        (True, True, 2 * AGE, SLOW, True, SILENT),
        (True, False, 2 * AGE, math.nan, True, SILENT),
        (True, True, 2 * AGE, FAST, False, SILENT),
    ],
)
def test_which_motion_is_stopped(
    moving: bool, permitted: bool, after: float, speed: float, can_stop: bool, fault: str
) -> None:
    watch = following(moving=moving, can_stop=can_stop, speed=0.0)
    now = 1.0 + after
    assert watch.fault(now, permitted=permitted, speed=speed) == fault
    assert watch.fault(now + 0.02, permitted=permitted, speed=speed) == ""  # once, until it is said again
    if fault in {UNHEARD, SILENT}:
        again = UNHEARD if can_stop and speed > MOVES else ""
        assert watch.fault(now + AGAIN + 0.02, permitted=True, speed=speed) == again


@pytest.mark.parametrize(
    ("moving", "speed", "silent", "identity", "count", "hears", "another"),
    [
        (False, 0.0, 0.05, OURS, 50, True, False),
        (False, 0.0, 0.05, OURS, 49, True, False),  # of the moment before: still young enough
        (False, 0.0, 0.5, OURS, 50, True, False),
        (False, 0.0, 0.5, OURS, 49, False, False),  # stands still
        (False, 0.0, 0.5, OURS, 3, False, False),  # played from a bag
        (False, 0.0, 0.05, OTHER, 0, True, True),  # beside the living one: named
        (True, FAST, 0.05, OTHER, 10**6, True, True),
        (True, FAST, 0.5, OTHER, 0, False, False),  # killed in motion: nobody takes over
        (True, 0.0, 0.5, OTHER, 0, False, False),  # its motion has not been stopped yet
        (False, FAST, 0.5, OTHER, 0, False, False),
        (False, math.nan, 0.5, OTHER, 0, False, False),  # unknown whether it stands
        (False, 0.0, 0.5, OTHER, 0, True, False),  # restarted
    ],
)
def test_whose_sign_of_life_counts(
    moving: bool, speed: float, silent: float, identity: int, count: int, hears: bool, another: bool
) -> None:
    watch = following(moving=moving, speed=speed)
    now = 1.0 + silent
    watch.on_pulse(identity, count, now, moving=not moving)
    assert (watch.hears(now), watch.another(now)) == (hears, another)
    assert not watch.another(now + REPORTED + 0.01)
    assert watch.moving is (not moving if hears and not another and (identity, count) != (OURS, 49) else moving)


def test_a_sequencer_is_followed_again_once_the_robot_stands() -> None:
    watch = following(moving=True, speed=FAST)
    faults, now = [], 1.0
    for step in range(100):  # killed; another one speaks from the same moment on, and says that nothing moves
        now = 1.0 + 0.02 * (step + 1)
        watch.on_pulse(OTHER, step, now, moving=False)
        fault = watch.fault(now, permitted=True, speed=FAST if now < 1.8 else 0.0)
        faults += [(fault, now)] if fault else []
    assert [fault for fault, _ in faults] == [SILENT, UNHEARD]
    assert faults[0][1] <= 1.0 + AGE + 0.021
    assert watch.hears(now)


@given(
    said=st.lists(
        st.tuples(st.floats(0.0, 0.3), st.sampled_from([OURS, OTHER]), st.booleans(), st.sampled_from([0.0, FAST]),
                  st.integers(-1, 2)), max_size=40
    )
)  # fmt: skip
def test_a_motion_that_nobody_reports_any_more_is_stopped_whoever_speaks(said: list) -> None:
    """As long as the followed one is silent in motion, no sign of life of another one makes the guard wait."""
    watch, now, counts = following(moving=True, speed=FAST), 1.0, {OURS: 49, OTHER: 0}
    dead = False
    for gap, identity, moving, speed, step in said:
        now += gap
        if identity == OTHER:
            counts[OTHER] += step
            watch.on_pulse(OTHER, counts[OTHER], now, moving=moving)
            if dead:
                continue
        silent = not watch.hears(now)
        was_moving = watch.moving
        fault = watch.fault(now, permitted=True, speed=speed)
        assert (fault == SILENT) == (silent and was_moving)
        dead = dead or fault == SILENT
        if identity == OURS and not dead:
            counts[OURS] += 1
            watch.on_pulse(OURS, counts[OURS], now, moving=True)
