"""What an operator may confirm, and how adapters and message types are found."""

from __future__ import annotations

import itertools
import math

import pytest

from calibration.robot_state.adapter import Report
from calibration.robot_state.catalogue import ADAPTERS, NAMES, adapter_of, load_type
from calibration.robot_state.confirmation import LONGEST, Confirmation, checked, confirmed
from calibration_core.errors import InputError
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

# --- the operator's word ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("reported", "word"), list(itertools.product(OperatingMode, OperatingMode)))
def test_an_operators_word_never_overrules_the_controller(reported: OperatingMode, word: OperatingMode) -> None:
    report = confirmed(Report(RobotStatus(operating_mode=reported)), Confirmation("A. Smith", word, 10.0), 5.0)
    manual = {OperatingMode.MANUAL_REDUCED, OperatingMode.MANUAL_HIGH}
    taken = reported is OperatingMode.UNKNOWN or (reported is OperatingMode.MANUAL_UNSPECIFIED and word in manual)
    assert report.status.operating_mode is (word if taken else reported)
    assert report.status.operator_confirmed is taken
    assert report.operator == ("A. Smith" if taken else "")


def test_an_operators_word_ends() -> None:
    word = Confirmation("A. Smith", OperatingMode.MANUAL_REDUCED, 10.0)
    nothing_heard = Report(adapter_of("manual_confirm").translate({}))
    status = confirmed(nothing_heard, word, 9.0).status
    assert (status.operating_mode, status.drives) == (OperatingMode.MANUAL_REDUCED, Drives.ON)
    assert status.safety is SafetyState.NORMAL
    ended = confirmed(nothing_heard, word, 10.0)
    assert ended.status.operating_mode is OperatingMode.UNKNOWN
    assert (ended.status.operator_confirmed, ended.status.confirmed_until) == (True, 10.0)
    assert confirmed(nothing_heard, None, 0.0) == nothing_heard


def test_what_can_be_confirmed() -> None:
    assert checked(" A. Smith ", 1, 60.0, 5.0) == Confirmation("A. Smith", OperatingMode.MANUAL_REDUCED, 65.0)
    for operator, mode, valid_for in (
        ("  ", 1, 60.0),
        ("A", 0, 60.0),
        ("A", 5, 60.0),
        ("A", 9, 60.0),
        ("A", 1, 0.0),
        ("A", 1, LONGEST + 1.0),
        ("A", 1, math.nan),
    ):
        with pytest.raises(InputError, match="confirmation"):
            checked(operator, mode, valid_for, 0.0)


# --- loading ---------------------------------------------------------------------------------------------------------


def test_names() -> None:
    assert set(NAMES) == {
        "native", "industrial", "ur", "kuka_kss", "kuka_fri", "abb", "fanuc", "staubli", "manual_confirm", "generic",
    }  # fmt: skip
    assert all(adapter_of(name).name == name for name in ADAPTERS)
    with pytest.raises(InputError, match="kuka_kss"):
        adapter_of("kuka")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("RobotStatus", "package/msg/Name"),
        ("a/b/c", "package/msg/Name"),
        ("os;x/msg/Name", "package/msg/Name"),
        ("no_such_msgs/msg/Name", "apt install ros-jazzy-no-such-msgs"),
        ("industrial_msgs/msg/RobotStatus", "built from its source"),
    ],
)
def test_types_that_cannot_be_loaded(text: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        load_type(text)
