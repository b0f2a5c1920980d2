"""What drivers say, in our words: every value of every field, and what happens to values that do not exist."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace as Message
from typing import Any

import pytest

from calibration.robot_state import abb, fanuc, generic, industrial, kuka_fri, kuka_kss, native, staubli, ur
from calibration.robot_state.adapter import Received, assemble
from calibration.robot_state.catalogue import ADAPTERS
from calibration_core.errors import InputError
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState
from calibration_core.timeseries import NANOSECONDS

TRI = {-1: None, 0: False, 1: True, 7: None}


def val(value: int) -> Message:
    return Message(val=value)


# --- every make ------------------------------------------------------------------------------------------------------


def industrial_status(**changes: Any) -> Message:
    fields = {name: val(0) for name in ("e_stopped", "motion_possible", "in_motion", "in_error")}
    return Message(**({"mode": val(1), "drives_powered": val(1), **fields, "error_codes": []} | changes))


@pytest.mark.parametrize(
    ("value", "mode"),
    [
        (-1, OperatingMode.UNKNOWN),
        (0, OperatingMode.UNKNOWN),
        (1, OperatingMode.MANUAL_UNSPECIFIED),
        (2, OperatingMode.AUTOMATIC),
        (3, OperatingMode.UNKNOWN),
    ],
)
def test_industrial_modes(value: int, mode: OperatingMode) -> None:
    assert industrial.translate({"status": industrial_status(mode=val(value))}).operating_mode is mode


@pytest.mark.parametrize("value", TRI)
def test_industrial_tri_states(value: int) -> None:
    names = ("drives_powered", "e_stopped", "motion_possible", "in_motion", "in_error")
    state = industrial.translate({"status": industrial_status(**{name: val(value) for name in names})})
    assert (state.motion_possible, state.in_motion, state.in_error) == (TRI[value],) * 3
    assert state.drives is {True: Drives.ON, False: Drives.OFF, None: Drives.UNKNOWN}[TRI[value]]
    expected = {True: SafetyState.EMERGENCY_STOP, False: SafetyState.NORMAL, None: SafetyState.UNKNOWN}
    assert state.safety is expected[TRI[value]]


def test_error_codes_of_both_generations() -> None:
    old, none = Message(error_code=9), Message(error_code=0)
    for message, codes in ((industrial_status(error_codes=[3, -5]), (3, -5)), (old, (9,)), (none, ())):
        assert assemble(industrial.ADAPTER, {"status": Received(message, 1)}, 1).vendor_codes == codes


@pytest.mark.parametrize("mode", range(-2, 11))
def test_ur_robot_modes(mode: int) -> None:
    state = ur.translate({"robot_mode": Message(mode=mode), "program": Message(data=True)})
    known = {7: Drives.ON} | dict.fromkeys((1, 2, 3, 4, 5, 6, 8), Drives.OFF)
    assert state.drives is known.get(mode, Drives.UNKNOWN)
    assert state.motion_possible is (mode == 7)


@pytest.mark.parametrize("running", [False, True, None])
def test_ur_needs_its_program(running: bool | None) -> None:
    messages = {"robot_mode": Message(mode=7)} | ({} if running is None else {"program": Message(data=running)})
    assert ur.translate(messages).motion_possible is running


@pytest.mark.parametrize("mode", range(15))
def test_ur_safety_modes(mode: int) -> None:
    expected = {
        1: SafetyState.NORMAL, 2: SafetyState.REDUCED, 3: SafetyState.PROTECTIVE_STOP, 4: SafetyState.FAULT,
        5: SafetyState.SAFEGUARD_STOP, 6: SafetyState.EMERGENCY_STOP, 7: SafetyState.EMERGENCY_STOP,
        8: SafetyState.FAULT, 9: SafetyState.FAULT, 10: SafetyState.FAULT, 12: SafetyState.SAFEGUARD_STOP,
        13: SafetyState.ENABLING_STOP,
    }.get(mode, SafetyState.UNKNOWN)  # fmt: skip
    assert ur.translate({"safety_mode": Message(mode=mode)}).safety is expected


@pytest.mark.parametrize(
    ("word", "success", "mode"),
    [
        ("MANUAL", True, OperatingMode.MANUAL_UNSPECIFIED),
        ("AUTOMATIC", True, OperatingMode.AUTOMATIC),
        ("AUTOMATIC", False, OperatingMode.UNKNOWN),
        ("NONE", True, OperatingMode.UNKNOWN),
    ],
)
def test_ur_operational_mode(word: str, success: bool, mode: OperatingMode) -> None:
    answer = Message(success=success, operational_mode=Message(mode=word))
    assert ur.translate({"operational_mode": answer}).operating_mode is mode


def test_ur_speed_scaling_is_in_percent() -> None:
    assert ur.translate({"scaling": Message(data=35.0)}).speed_scaling == pytest.approx(0.35)
    assert math.isnan(ur.translate({}).speed_scaling)


def kss(**changes: Any) -> Message:
    fields = {
        "operation_mode": 1, "drives_powered": True, "emergency_stop": False, "guard_stop": False, "in_motion": False,
        "motion_possible": True,
    }  # fmt: skip
    return Message(statuses=[Message(**(fields | changes))])


@pytest.mark.parametrize("mode", range(6))
def test_kss_modes(mode: int) -> None:
    words = {
        1: OperatingMode.MANUAL_REDUCED,
        2: OperatingMode.MANUAL_HIGH,
        3: OperatingMode.AUTOMATIC,
        4: OperatingMode.EXTERNAL,
    }
    found = kuka_kss.translate({"status": kss(operation_mode=mode)}).operating_mode
    assert found is words.get(mode, OperatingMode.UNKNOWN)


@pytest.mark.parametrize(("emergency", "guard"), list(itertools.product([False, True], repeat=2)))
def test_kss_safety(emergency: bool, guard: bool) -> None:
    state = kuka_kss.translate({"status": kss(emergency_stop=emergency, guard_stop=guard)})
    expected = SafetyState.EMERGENCY_STOP if emergency else SafetyState.SAFEGUARD_STOP if guard else SafetyState.NORMAL
    assert state.safety is expected


@pytest.mark.parametrize("value", [False, True])
def test_kss_flags(value: bool) -> None:
    state = kuka_kss.translate({"status": kss(drives_powered=value, in_motion=value, motion_possible=value)})
    assert state.drives is (Drives.ON if value else Drives.OFF)
    assert state.in_motion is state.motion_possible is (value)


@pytest.mark.parametrize("count", [0, 2])
def test_other_than_one_robot_is_unknown(count: int) -> None:
    assert kuka_kss.translate({"status": Message(statuses=kss().statuses * count)}) == RobotStatus()
    assert kuka_fri.translate({"state": Message(states=[Message(operation_mode=0)] * count)}) == RobotStatus()


@pytest.mark.parametrize(("mode", "drive", "safety"), list(itertools.product(range(-1, 4), range(-1, 4), range(-1, 5))))
def test_fri(mode: int, drive: int, safety: int) -> None:
    one = Message(operation_mode=mode, drive_state=drive, safety_state=safety, session_state=4)
    state = kuka_fri.translate({"state": Message(states=[one])})
    modes = {0: OperatingMode.MANUAL_REDUCED, 1: OperatingMode.MANUAL_HIGH, 2: OperatingMode.AUTOMATIC}
    assert state.operating_mode is modes.get(mode, OperatingMode.UNKNOWN)
    assert state.drives is {0: Drives.OFF, 1: Drives.OFF, 2: Drives.ON}.get(drive, Drives.UNKNOWN)
    assert (state.safety is SafetyState.NORMAL) == (safety == 0)
    assert (state.safety is SafetyState.UNKNOWN) == (safety not in range(4))


@pytest.mark.parametrize("session", range(5))
def test_fri_moves_only_while_commanded(session: int) -> None:
    state = kuka_fri.translate({"state": Message(states=[Message(session_state=session)])})
    assert state.motion_possible is (session == 4)


@pytest.mark.parametrize(("motors", "auto", "rapid"), list(itertools.product([None, False, True], repeat=3)))
def test_abb(motors: bool | None, auto: bool | None, rapid: bool | None) -> None:
    state = abb.translate({"system": Message(motors_on=motors, auto_mode=auto, rapid_running=rapid)})
    modes = {None: OperatingMode.UNKNOWN, False: OperatingMode.MANUAL_UNSPECIFIED, True: OperatingMode.AUTOMATIC}
    assert state.operating_mode is modes[auto]
    assert state.drives is {None: Drives.UNKNOWN, False: Drives.OFF, True: Drives.ON}[motors]
    assert state.safety is (SafetyState.NORMAL if motors else SafetyState.UNKNOWN)
    assert state.motion_possible is rapid


@pytest.mark.parametrize(("pendant", "stopped", "powered"), list(itertools.product([None, False, True], repeat=3)))
def test_fanuc(pendant: bool | None, stopped: bool | None, powered: bool | None) -> None:
    status = Message(tp_enabled=pendant, e_stopped=stopped, motion_possible=True, in_error=False)
    extended = Message(drives_powered=powered, in_motion=False, gen_override=50)
    state = fanuc.translate({"status": status, "extended": extended})
    modes = {None: OperatingMode.UNKNOWN, True: OperatingMode.MANUAL_UNSPECIFIED, False: OperatingMode.AUTOMATIC}
    assert state.operating_mode is modes[pendant]
    assert (
        state.safety
        is {None: SafetyState.UNKNOWN, False: SafetyState.NORMAL, True: SafetyState.EMERGENCY_STOP}[stopped]
    )
    assert state.drives is {None: Drives.UNKNOWN, False: Drives.OFF, True: Drives.ON}[powered]
    assert (state.motion_possible, state.in_error, state.in_motion) == (True, False, False)
    assert state.speed_scaling == pytest.approx(0.5)


def staubli_states(**values: float) -> Message:
    usual = {
        "operation_mode": 3.0, "safety_status": 0.0, "estop_pressed": 0.0, "power_on": 1.0, "motion_possible": 1.0,
        "in_motion": 0.0, "in_error": 0.0,
    } | values  # fmt: skip
    group = Message(interface_names=list(usual), values=list(usual.values()))
    return Message(interface_groups=["digital", "supervision"], interface_values=[Message(), group])


@pytest.mark.parametrize("mode", [-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 1.5, math.nan, math.inf])
def test_staubli_modes(mode: float) -> None:
    words = {1.0: OperatingMode.MANUAL_UNSPECIFIED, 2.0: OperatingMode.AUTOMATIC, 3.0: OperatingMode.EXTERNAL}
    found = staubli.translate({"states": staubli_states(operation_mode=mode)}).operating_mode
    assert found is words.get(mode, OperatingMode.UNKNOWN)


@pytest.mark.parametrize(
    ("pressed", "status"), list(itertools.product([0.0, 1.0, 0.5], [-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]))
)
def test_staubli_safety(pressed: float, status: float) -> None:
    words = {
        0.0: SafetyState.NORMAL,
        1.0: SafetyState.PROTECTIVE_STOP,
        2.0: SafetyState.SAFEGUARD_STOP,
        3.0: SafetyState.SAFEGUARD_STOP,
        4.0: SafetyState.ENABLING_STOP,
    }
    expected = {0.0: words.get(status, SafetyState.UNKNOWN), 1.0: SafetyState.EMERGENCY_STOP, 0.5: SafetyState.UNKNOWN}[
        pressed
    ]
    state = staubli.translate({"states": staubli_states(estop_pressed=pressed, safety_status=status)})
    assert state.safety is expected


def test_staubli_without_the_group() -> None:
    assert staubli.translate({"states": Message(interface_groups=["x"], interface_values=[Message()])}).drives is (
        Drives.UNKNOWN
    )


def own(**changes: Any) -> Message:
    fields: dict[str, Any] = {
        "operating_mode": 1, "drives": 2, "safety": 1, "motion_possible": 1, "in_motion": 0, "in_error": 0,
        "speed_scaling": 1.0, "speed_limit_mm_s": 250.0, "vendor_codes": [],
    }  # fmt: skip
    return Message(**(fields | changes))


@pytest.mark.parametrize("number", range(-1, 10))
def test_native_numbers(number: int) -> None:
    state = native.translate({"state": own(operating_mode=number, drives=number, safety=number, in_error=number)})
    for word, kind in zip(
        (state.operating_mode, state.drives, state.safety), (OperatingMode, Drives, SafetyState), strict=True
    ):
        assert word == (number if number in list(map(int, kind)) else 0)
    assert state.in_error is {0: False, 1: True}.get(number)


def test_native_limits() -> None:
    state = native.translate({"state": own()})
    assert state.speed_limit == pytest.approx(0.25)
    silent = native.translate({"state": own(speed_limit_mm_s=math.nan, speed_scaling=math.inf)})
    assert math.isnan(silent.speed_limit)
    assert math.isnan(silent.speed_scaling)


# --- any make --------------------------------------------------------------------------------------------------------

RULES = {
    "operating_mode": "status.mode = 3: MANUAL_REDUCED, 4: AUTOMATIC",
    "drives": "status.power = true: ON, false: OFF",
    "safety": "safety.0 = ok: NORMAL",
}


@pytest.mark.parametrize(
    ("mode", "power", "word"), list(itertools.product([3, 4, 5, "3"], [True, False, 1], ["ok", "bad"]))
)
def test_generic(mode: Any, power: Any, word: str) -> None:
    adapter = generic.adapter("status", "std_msgs/msg/String", 1.0, RULES)
    message = Message(status=Message(mode=mode, power=power), safety=[word])
    state = adapter.translate({"state": message})
    modes = {"3": OperatingMode.MANUAL_REDUCED, "4": OperatingMode.AUTOMATIC}
    assert state.operating_mode is modes.get(str(mode), OperatingMode.UNKNOWN)
    assert state.drives is (Drives.UNKNOWN if power == 1 and power is not True else Drives.ON if power else Drives.OFF)
    assert state.safety is (SafetyState.NORMAL if word == "ok" else SafetyState.UNKNOWN)
    assert state.in_error is None


def test_generic_with_fields_that_do_not_exist() -> None:
    adapter = generic.adapter("status", "std_msgs/msg/String", 1.0, RULES)
    assert adapter.translate({"state": Message(safety=[])}) == RobotStatus()
    assert adapter.translate({}) == RobotStatus()


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"drives": ""}, "drives"),
        ({"drives": "power"}, "power"),
        ({"drives": "= true: ON"}, "true"),
        ({"drives": "power = true: RUNNING"}, "RUNNING"),
        ({"drives": "power = true"}, "true"),
        ({"colour": "a = b: c"}, "colour"),
    ],
)
def test_generic_rules_that_cannot_be_read(change: dict[str, str], found: str) -> None:
    with pytest.raises(InputError, match=found):
        generic.adapter("status", "std_msgs/msg/String", 1.0, RULES | change)


# --- all of them -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("adapter", ADAPTERS.values(), ids=ADAPTERS)
def test_silence_is_unknown(adapter: Any) -> None:
    report = assemble(adapter, {}, 10)
    assert report.status.operating_mode is OperatingMode.UNKNOWN
    if adapter.sources:
        assert report.status == RobotStatus()
        assert report.received_time == 0
        assert any(source.max_age is not None for source in adapter.sources)
        assert len({source.key for source in adapter.sources}) == len(adapter.sources)


@pytest.mark.parametrize("adapter", ADAPTERS.values(), ids=ADAPTERS)
def test_messages_of_another_kind_are_unknown(adapter: Any) -> None:
    if adapter.name in {"manual_confirm", "native"}:
        return  # no message; our own message, which has its fields
    state = adapter.translate({source.key: Message() for source in adapter.sources})
    assert (state.operating_mode, state.drives) == (OperatingMode.UNKNOWN, Drives.UNKNOWN)


def test_a_source_that_falls_silent_counts_no_longer() -> None:
    status, extended = Message(tp_enabled=True, e_stopped=False), Message(drives_powered=True)
    received = {"status": Received(status, 0), "extended": Received(extended, 3 * NANOSECONDS // 10)}
    fresh = assemble(fanuc.ADAPTER, received, 4 * NANOSECONDS // 10)
    assert (fresh.status.operating_mode, fresh.status.drives) == (OperatingMode.MANUAL_UNSPECIFIED, Drives.ON)
    assert fresh.received_time == 0
    later = assemble(fanuc.ADAPTER, received, 6 * NANOSECONDS // 10)
    assert (later.status.operating_mode, later.status.drives) == (OperatingMode.UNKNOWN, Drives.ON)


def test_topics_sent_at_changes_do_not_age() -> None:
    received = {
        "robot_mode": Received(Message(mode=7), 0),
        "safety_mode": Received(Message(mode=1), 0),
        "scaling": Received(Message(data=100.0), 100 * NANOSECONDS),
        "operational_mode": Received(Message(success=True, operational_mode=Message(mode="MANUAL")), 99 * NANOSECONDS),
    }
    state = assemble(ur.ADAPTER, received, 100 * NANOSECONDS)
    assert (state.status.drives, state.status.safety) == (Drives.ON, SafetyState.NORMAL)
    assert state.received_time == 99 * NANOSECONDS


def test_the_stamp_is_the_oldest_there_is() -> None:
    header = Message(stamp=Message(sec=5, nanosec=7))
    state = assemble(abb.ADAPTER, {"system": Received(Message(header=header), 10)}, 10)
    assert state.source_time == 5 * NANOSECONDS + 7
    assert "abb" in state.source
