"""What is heard of the guard: a word that is old, that names a fault, or that never came, permits nothing."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("calibration_interfaces")

from calibration_interfaces.msg import Permission

from calibration.cell.watches import SILENT, PermissionWatch

MAX_AGE = 0.5  # s


def _word(*reasons: int, permitted: bool = False, latched: bool = False, hears: bool = True) -> Permission:
    return Permission(permitted=permitted, reasons=reasons, latched=latched, hears_sequencer=hears, text="as it is")


def _heard(word: Permission, now: float = 10.0) -> PermissionWatch:
    watch = PermissionWatch(MAX_AGE)
    watch.hear(word, now)
    return watch


def test_before_the_first_word_nothing_is_permitted() -> None:
    watch = PermissionWatch(MAX_AGE)
    assert watch.at(0.0) == (False, SILENT)
    assert not watch.ready(0.0)
    assert not watch.hears(0.0)
    assert watch.against == -math.inf


@pytest.mark.parametrize(("later", "fresh"), [(0.0, True), (0.9 * MAX_AGE, True), (1.1 * MAX_AGE, False)])
def test_a_word_counts_as_long_as_it_is_fresh(later: float, fresh: bool) -> None:
    watch = _heard(_word(permitted=True))
    assert watch.at(10.0 + later) == ((True, "as it is") if fresh else (False, SILENT))
    assert watch.ready(10.0 + later) is fresh
    assert watch.hears(10.0 + later) is fresh


def test_a_guard_that_does_not_hear_the_sequencer_is_not_said_to() -> None:
    assert not _heard(_word(permitted=True, hears=False)).hears(10.0)


@pytest.mark.parametrize(
    ("reasons", "ready"),
    [
        ((), True),
        ((Permission.STOP_UNPROVEN,), True),
        ((Permission.STOP_UNPROVEN, Permission.JOINTS_FROZEN), True),  # the proof is tried while the robot stands
        ((Permission.JOINTS_FROZEN,), False),
        ((Permission.LATCHED,), False),
        ((Permission.STOP_UNPROVEN, Permission.LATCHED), False),
    ],
)
def test_nothing_but_a_missing_proof_may_speak_against_being_ready(reasons: tuple[int, ...], ready: bool) -> None:
    watch = _heard(_word(*reasons, latched=Permission.LATCHED in reasons))
    assert watch.ready(10.0) is ready
    assert watch.at(10.0) == (False, "as it is")
    assert watch.against == (-math.inf if ready else 10.0)
    assert watch.latched is (Permission.LATCHED in reasons)
    assert watch.unproven is (Permission.STOP_UNPROVEN in reasons)


def test_a_fault_of_the_past_is_remembered_by_its_time_alone() -> None:
    watch = _heard(_word(Permission.LATCHED, latched=True))
    watch.hear(_word(permitted=True), 11.0)
    assert watch.at(11.0)[0]
    assert not watch.latched
    assert watch.against == 10.0


@pytest.mark.parametrize(
    "reason",
    [Permission.DRIVES_OFF, Permission.MODE_NOT_ALLOWED, Permission.SAFETY_STOP, Permission.STATE_STALE,
     Permission.CONFIRMATION_EXPIRED],
)  # fmt: skip
def test_a_robot_that_was_not_sound_is_remembered(reason: int) -> None:
    watch = _heard(_word(permitted=True))
    watch.hear(_word(reason), 10.1)
    watch.hear(_word(permitted=True), 10.2)
    assert watch.unsound(10.15, 10.3) == ""
    assert watch.unsound(10.05, 10.3) == "as it is"


def test_what_speaks_against_motion_alone_is_nothing_to_a_reading() -> None:
    watch = _heard(_word(permitted=True))
    watch.hear(_word(Permission.OVER_SPEED, Permission.LATCHED), 10.1)
    assert watch.unsound(10.05, 10.2) == ""


def test_a_guard_that_was_silent_leaves_the_robot_unknown() -> None:
    watch = _heard(_word(permitted=True))
    assert watch.unsound(10.05, 12.4) == ""
    assert watch.unsound(10.05, 12.6) == SILENT
    watch.hear(_word(permitted=True), 12.6)
    assert watch.unsound(10.05, 12.7) == SILENT
    assert watch.unsound(12.65, 12.7) == ""


def test_a_moment_is_judged_once_a_state_of_after_it_was() -> None:
    watch = _heard(_word(permitted=True))
    assert not watch.judged(10.05)
    watch.state(10.1)
    assert not watch.judged(10.05)
    watch.hear(_word(permitted=True), 10.15)
    assert watch.judged(10.05)
    assert not watch.judged(10.12)
