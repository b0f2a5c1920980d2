"""What is heard of the guard: a word that is old, that names a fault, or that never came, permits nothing."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("calibration_interfaces")

from calibration_interfaces.msg import Permission

from calibration.cell.permission import SILENT, PermissionWatch

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
