"""What an operator may confirm, and when it ends."""

from __future__ import annotations

import itertools
import math

import pytest

from calibration.robot_state.adapter import Confirmation, Report, checked, confirmed, load_adapter
from calibration_core.errors import InputError
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

UNKNOWN, UNSPECIFIED = OperatingMode.UNKNOWN, OperatingMode.MANUAL_UNSPECIFIED
REDUCED, AUTOMATIC = OperatingMode.MANUAL_REDUCED, OperatingMode.AUTOMATIC


@pytest.mark.parametrize(("reported", "word"), list(itertools.product(OperatingMode, OperatingMode)))
def test_an_operators_word_never_overrules_the_controller(reported: OperatingMode, word: OperatingMode) -> None:
    manual = {OperatingMode.MANUAL_REDUCED, OperatingMode.MANUAL_HIGH}
    open_ones = {UNKNOWN: set(OperatingMode) - {UNKNOWN, UNSPECIFIED}, UNSPECIFIED: manual}
    if word in open_ones.get(reported, set()):
        given = checked(" A. Smith ", word, 10.0, reported, 5.0)
        assert given == Confirmation("A. Smith", word, reported, 15.0)
    else:
        with pytest.raises(InputError, match="operating_mode"):
            checked("A. Smith", word, 10.0, reported, 5.0)
        given = Confirmation("A. Smith", word, UNKNOWN if reported is UNSPECIFIED else UNSPECIFIED, 15.0)
    report = confirmed(Report(RobotStatus(operating_mode=reported)), given, 6.0)
    taken = word in open_ones.get(reported, set())
    assert report.status.operating_mode is (word if taken else reported)
    assert report.status.operator_confirmed is taken
    assert report.operator == ("A. Smith" if taken else "")


ON, OFF = Drives.ON, Drives.OFF
HOUR = 3600.0


@pytest.mark.parametrize(
    ("reported", "seen", "holds"),
    [
        ("same", [], True),
        ("same", [(1.0, "same", ON), (HOUR - 0.1, "same", ON)], True),
        ("same", [(HOUR, "same", ON)], False),  # whatever was asked for
        ("manual", [(1.0, AUTOMATIC, ON), (1.1, UNSPECIFIED, ON)], False),
        ("manual", [(1.0, UNKNOWN, ON), (1.1, UNSPECIFIED, ON)], False),  # its source was silent for a moment
        ("manual", [(1.0, REDUCED, ON), (1.1, UNSPECIFIED, ON)], False),
        ("silent", [(1.0, UNSPECIFIED, ON), (1.1, UNKNOWN, ON)], False),
        ("silent", [(1.0, UNSPECIFIED, ON)], False),
        ("same", [(1.0, "same", OFF), (60.9, "same", OFF), (60.95, "same", ON)], True),
        ("same", [(1.0, "same", OFF), (60.0, "same", OFF)], True),
        ("same", [(1.0, "same", OFF), (61.0, "same", OFF), (61.1, "same", ON)], False),
        ("same", [(1.0, "same", OFF), (62.0, "same", ON)], False),  # nothing was heard between
        ("same", [(1.0, "same", Drives.UNKNOWN), (62.0, "same", OFF), (62.1, "same", ON)], False),
        ("same", [(1.0, "same", OFF), (40.0, "same", ON), (41.0, "same", OFF), (100.0, "same", OFF)], True),
        ("same", [(1.0, AUTOMATIC, ON), (2.0, "same", ON), (3.0, "same", ON)], False),
    ],
)
def test_when_an_operators_word_ends(reported: str, seen: list, holds: bool) -> None:
    """What ended once does not come back, whatever is reported later; where the mode is not told, drives may be."""
    for kind in {"same": (UNKNOWN, UNSPECIFIED), "manual": (UNSPECIFIED,), "silent": (UNKNOWN,)}[reported]:
        word = checked("A. Smith", REDUCED, 8 * HOUR, kind, 0.0)
        now, last = 0.0, kind
        for now, told, drives in seen:
            last = kind if told == "same" else told
            word = word.after(RobotStatus(operating_mode=last, drives=drives), now)
        status = confirmed(Report(RobotStatus(operating_mode=last, drives=ON)), word, now).status
        assert status.operator_confirmed  # so that the reason can be named
        assert (status.operating_mode is REDUCED) == holds == (now < status.confirmed_until)


def test_where_the_controller_says_nothing_an_operators_word_covers_the_drives() -> None:
    nothing_heard = Report(load_adapter("manual_confirm").translate({}))
    word = checked("A. Smith", REDUCED, 600.0, UNKNOWN, 0.0)
    for second in range(0, 600, 10):
        word = word.after(nothing_heard.status, second)
    status = confirmed(nothing_heard, word, 599.0).status
    assert (status.operating_mode, status.drives, status.safety) == (REDUCED, ON, SafetyState.NORMAL)
    assert confirmed(nothing_heard, word, 600.0).status.operating_mode is UNKNOWN
    assert confirmed(nothing_heard, None, 0.0) == nothing_heard


@pytest.mark.parametrize(
    ("operator", "mode", "valid_for", "found"),
    [("  ", 1, 60.0, "operator_name"), ("A", 9, 60.0, "operating_mode"), ("A", 1, 0.0, "valid_for"),
     ("A", 1, math.inf, "valid_for"), ("A", 1, math.nan, "valid_for")],
)  # fmt: skip
def test_what_cannot_be_confirmed(operator: str, mode: int, valid_for: float, found: str) -> None:
    with pytest.raises(InputError, match=found):
        checked(operator, mode, valid_for, UNKNOWN, 0.0)
