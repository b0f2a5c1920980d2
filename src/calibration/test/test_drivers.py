"""Drivers' tables against the drivers' own interface definitions, and what the engine makes of their messages."""

from __future__ import annotations

import functools
import itertools
import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from vendored import FOLDER, Vendored

from calibration.robot_state import FOLDER as TABLES
from calibration.robot_state import GENERIC, NAMES
from calibration.robot_state.adapter import Adapter, Received, assemble, load_adapter
from calibration.topics import load_type
from calibration_core.errors import InputError
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState
from calibration_core.timeseries import NANOSECONDS

OWN = ("native", "manual_confirm")  # which no maker's driver speaks
MAKERS = tuple(name for name in NAMES if name not in (*OWN, GENERIC))
INDEX = yaml.safe_load((FOLDER / "index.yaml").read_text("utf-8"))
RELEASES = [(name, release) for name in MAKERS for release in load_adapter(name).releases]


@functools.cache
def loaded(name: str, release: str) -> tuple[Adapter, Vendored]:
    vendored = Vendored(FOLDER / name / release)
    return load_adapter(name).loaded(vendored), vendored


def state(adapter: Adapter, vendored: Vendored, **said: Mapping[str, Any]) -> RobotStatus:
    """Return what the engine makes of messages of the driver's own types, written and read as on the wire."""
    messages = {}
    for key, values in said.items():
        kind = adapter.sources[key].kind
        message = vendored.make(kind, values)
        raw = vendored.store.serialize_cdr(message, message.__msgtype__)
        messages[key] = vendored.store.deserialize_cdr(raw, message.__msgtype__)
    return adapter.translate(messages)


# --- the drivers' definitions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "release"), RELEASES)
def test_what_a_table_reads_exists_in_the_release(name: str, release: str) -> None:
    loaded(name, release)  # which names what is missing


@pytest.mark.parametrize(("name", "release"), RELEASES)
def test_a_release_is_vendored_with_its_origin(name: str, release: str) -> None:
    entry, table = INDEX[f"{name}/{release}"], load_adapter(name)
    assert re.fullmatch(r"[0-9a-f]{40}", table.releases[release])
    assert entry["repository"] in table.driver
    if entry["repository"] == table.driver.split(",")[0]:
        assert entry["commit"] == table.releases[release]
    assert entry["licence"] in ("Apache-2.0", "BSD-3-Clause")


def test_nothing_else_is_vendored() -> None:
    folders = {str(path.relative_to(FOLDER)) for path in FOLDER.glob("*/*") if path.is_dir()}
    assert folders == {f"{name}/{release}" for name, release in RELEASES}


@pytest.mark.parametrize("release", load_adapter("staubli").releases)
def test_the_interfaces_that_the_staubli_driver_exports(release: str) -> None:
    exported = set((FOLDER / "staubli" / release / "supervision.txt").read_text("utf-8").split())
    read = re.findall(r"interface_names=(\w+)", (TABLES / "staubli.yaml").read_text("utf-8"))
    assert set(read) - exported == set()


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("bool tp_enabled", "bool pendant"), "operating_mode: RobotStatus without field tp_enabled"),
        (("bool tp_enabled", "int8 tp_enabled"), "RobotStatus without constant true for tp_enabled"),
        (None, "found no such type"),
    ],
)
def test_an_interface_that_has_changed_is_named(tmp_path: Path, change: Any, found: str) -> None:
    for path in (FOLDER / "fanuc" / "2.2.0").rglob("*.msg"):
        there = tmp_path / path.relative_to(FOLDER / "fanuc" / "2.2.0")
        there.parent.mkdir(parents=True, exist_ok=True)
        if change is not None or path.stem != "RobotStatus":
            there.write_text(path.read_text("utf-8").replace(*(change or ("", ""))), "utf-8")
    with pytest.raises(InputError, match=found):
        load_adapter("fanuc").loaded(Vendored(tmp_path))


def test_every_source_of_a_driver_says_where_its_age_comes_from() -> None:
    silent = [(name, key) for name in MAKERS for key, one in load_adapter(name).sources.items() if not one.evidence]
    assert silent == []


@pytest.mark.parametrize("name", NAMES[:-1] if NAMES[-1] == GENERIC else NAMES)
def test_names_are_relative_to_the_cells_namespace(name: str) -> None:
    assert [one.name for one in load_adapter(name).sources.values() if one.name.startswith("/")] == []


# --- messages of the drivers -----------------------------------------------------------------------------------------

REDUCED, HIGH, MANUAL = OperatingMode.MANUAL_REDUCED, OperatingMode.MANUAL_HIGH, OperatingMode.MANUAL_UNSPECIFIED
AUTOMATIC, EXTERNAL = OperatingMode.AUTOMATIC, OperatingMode.EXTERNAL
GOOD = (Drives.ON, SafetyState.NORMAL)
KSS = {"operation_mode": 1, "drives_powered": True, "motion_possible": True}
FRI = {"session_state": 4, "drive_state": 2, "operation_mode": 0}
SUPERVISION = {
    "operation_mode": 1.0, "operation_mode_status": 0.0, "safety_status": 0.0, "control_sequence_delay": 4.0,
    "brakes_released": 1.0, "motion_possible": 1.0, "in_motion": 0.0, "in_error": 0.0, "estop_pressed": 0.0,
    "wait_for_ack": 0.0,
}  # fmt: skip


def gpio(**changes: float) -> dict[str, Any]:
    values = SUPERVISION | changes
    group = {"interface_names": list(values), "values": list(values.values())}
    other = {"interface_names": ["digital_input_0"], "values": [0.0]}
    return {"states": {"interface_groups": ["gpio", "supervision"], "interface_values": [other, group]}}


UR = {
    "robot_mode": {"mode": 7}, "safety_mode": {"mode": 1}, "program": {"data": True}, "scaling": {"data": 35.0},
    "operational_mode": {"success": True, "operational_mode": {"mode": "MANUAL"}},
}  # fmt: skip
FANUC = {"status": {"tp_enabled": True}, "extended": {"drives_powered": True, "gen_override": 10}}
CASES: list[tuple[str, str, dict[str, Any], tuple[Any, ...], bool | None]] = [
    ("ur", "jazzy", UR, (MANUAL, *GOOD), True),
    ("ur", "rolling", UR | {"safety_mode": {"mode": 13}}, (MANUAL, Drives.ON, SafetyState.ENABLING_STOP), True),
    ("ur", "3.7.0", {key: UR[key] for key in UR if key != "operational_mode"}, (OperatingMode.UNKNOWN, *GOOD), True),
    *[("kuka_kss", r, {"status": KSS}, (REDUCED, *GOOD), True) for r in ("2.0.0", "humble")],
    ("kuka_kss", "master", {"status": {"robot_names": [""], "statuses": [KSS]}}, (REDUCED, *GOOD), True),
    ("kuka_kss", "2.0.0", {"status": KSS | {"operation_mode": 4, "emergency_stop": True}},
     (EXTERNAL, Drives.ON, SafetyState.EMERGENCY_STOP), True),
    ("kuka_kss", "2.0.0", {"status": KSS | {"operation_mode": 2, "guard_stop": True, "motion_possible": False}},
     (HIGH, Drives.ON, SafetyState.SAFEGUARD_STOP), False),
    *[("kuka_fri", r, {"state": FRI}, (REDUCED, *GOOD), True) for r in ("2.0.0", "humble", "rolling")],
    ("kuka_fri", "master", {"state": {"states": [FRI | {"session_state": 2}]}}, (REDUCED, *GOOD), False),
    *[("abb", r, {"system": {"motors_on": True}}, (MANUAL, *GOOD), False) for r in ("rolling", "humble")],
    ("abb", "humble", {"system": {"auto_mode": True}}, (AUTOMATIC, Drives.OFF, SafetyState.UNKNOWN), False),
    *[("fanuc", r, FANUC, (MANUAL, *GOOD), False) for r in ("2.2.0", "1.4.0", "1.0.0")],
    ("fanuc", "2.2.0", {"status": {"e_stopped": True}},
     (AUTOMATIC, Drives.UNKNOWN, SafetyState.EMERGENCY_STOP), False),
    *[("staubli", r, gpio(), (MANUAL, *GOOD), True) for r in ("main", "0.1.4", "0.1.3")],
    ("staubli", "main", gpio(operation_mode=3.0, estop_pressed=1.0, safety_status=2.0),
     (EXTERNAL, Drives.ON, SafetyState.EMERGENCY_STOP), True),
    # As recorded in public threads: UniversalRobots/Universal_Robots_ROS_Driver#141 (robot running, emergency stop hit;
    # ROS 1, whose message has one error code instead of a list), UniversalRobots/Universal_Robots_ROS2_Driver#1188.
    ("industrial", "ros2_msgs_only", {"status": {
        "mode": {"val": 2}, "e_stopped": {"val": 0}, "drives_powered": {"val": 1}, "motion_possible": {"val": 1},
        "in_motion": {"val": -1}, "in_error": {"val": 1}}}, (AUTOMATIC, *GOOD), True),
    ("industrial", "ros2_msgs_only", {"status": {
        "mode": {"val": 2}, "e_stopped": {"val": 1}, "drives_powered": {"val": 1}, "motion_possible": {"val": 0},
        "in_motion": {"val": -1}, "in_error": {"val": 1}}}, (AUTOMATIC, Drives.ON, SafetyState.EMERGENCY_STOP), False),
    ("ur", "jazzy", {"robot_mode": {"mode": 7}}, (OperatingMode.UNKNOWN, Drives.ON, SafetyState.UNKNOWN), None),
]  # fmt: skip


@pytest.mark.parametrize(("name", "release", "said", "words", "possible"), CASES)
def test_a_message_of_the_drivers_own_type(
    name: str, release: str, said: dict[str, Any], words: tuple[Any, ...], possible: bool | None
) -> None:
    found = state(*loaded(name, release), **said)
    assert (found.operating_mode, found.drives, found.safety, found.motion_possible) == (*words, possible)


def test_every_release_has_a_message() -> None:
    assert {(name, release) for name, release, *_ in CASES} == set(RELEASES)


def test_numbers_and_truths_beside_the_words() -> None:
    assert state(*loaded("ur", "jazzy"), **UR).speed_scaling == pytest.approx(0.35)
    fanuc = state(*loaded("fanuc", "2.2.0"), **FANUC)
    assert (fanuc.speed_scaling, fanuc.in_motion, fanuc.in_error) == (pytest.approx(0.1), False, False)
    moving = state(*loaded("staubli", "main"), **gpio(in_motion=1.0, in_error=1.0))
    assert (moving.in_motion, moving.in_error) == (True, True)
    adapter, vendored = loaded("industrial", "ros2_msgs_only")
    message = vendored.make("industrial_msgs/msg/RobotStatus", {"error_codes": [4107, -3]})
    assert assemble(adapter, {"status": Received(message, 1)}, 1).vendor_codes == (4107, -3)


@pytest.mark.parametrize("count", [0, 2])
def test_of_several_robots_in_one_message_none_is_ours(count: int) -> None:
    kss, fri = loaded("kuka_kss", "master"), loaded("kuka_fri", "master")
    assert state(*kss, status={"statuses": [KSS] * count}) == RobotStatus()
    assert state(*fri, state={"states": [FRI] * count}) == RobotStatus()


def test_a_mode_that_the_robot_could_not_tell_is_unknown() -> None:
    for answer in ({"success": False, "operational_mode": {"mode": "MANUAL"}},
                   {"success": True, "operational_mode": {"mode": "NONE"}}):  # fmt: skip
        assert (
            state(*loaded("ur", "jazzy"), **UR | {"operational_mode": answer}).operating_mode is OperatingMode.UNKNOWN
        )


@pytest.mark.parametrize(("name", "release"), RELEASES)
def test_values_that_stand_for_nothing_are_unknown(name: str, release: str) -> None:
    """Numbers beyond the constants, silence, and messages of another kind: never a guess, never an exception."""
    adapter, _ = loaded(name, release)
    strange = SimpleNamespace(**dict.fromkeys(re.findall(r"\w+", " ".join(map(str, adapter.state.values()))), 99))
    for messages in ({}, dict.fromkeys(adapter.sources, strange), dict.fromkeys(adapter.sources, None)):
        found = adapter.translate(messages)
        words = (found.operating_mode, found.drives, found.safety)
        assert words == (OperatingMode.UNKNOWN, Drives.UNKNOWN, SafetyState.UNKNOWN)


@pytest.mark.parametrize("value", [-1.0, 1.5, math.nan, math.inf])
def test_floats_that_are_no_whole_numbers_are_unknown(value: float) -> None:
    found = state(*loaded("staubli", "main"), **gpio(operation_mode=value, brakes_released=value))
    assert (found.operating_mode, found.drives) == (OperatingMode.UNKNOWN, Drives.UNKNOWN)


def test_our_own_message() -> None:
    pytest.importorskip("calibration_interfaces.msg")
    from calibration_interfaces.msg import RobotState

    adapter = load_adapter("native").loaded()
    for mode, drives, safety in itertools.product(OperatingMode, Drives, SafetyState):
        message = RobotState(operating_mode=int(mode), drives=int(drives), safety=int(safety), motion_possible=1,
                             in_motion=0, in_error=-1, speed_limit_mm_s=250.0)  # fmt: skip
        found = adapter.translate({"state": message})
        assert (found.operating_mode, found.drives, found.safety) == (mode, drives, safety)
        assert (found.motion_possible, found.in_motion, found.in_error) == (True, False, None)
        assert found.speed_limit == pytest.approx(0.25)


# --- ages ------------------------------------------------------------------------------------------------------------


def test_a_source_that_falls_silent_counts_no_longer_and_the_report_names_it() -> None:
    adapter, vendored = loaded("fanuc", "2.2.0")
    status = vendored.make("fanuc_msgs/msg/RobotStatus", {"tp_enabled": True})
    extended = vendored.make("fanuc_msgs/msg/RobotStatusExt", {"drives_powered": True})
    received = {"status": Received(status, NANOSECONDS)}
    alone = assemble(adapter, received, NANOSECONDS)
    assert (alone.received_time, alone.first) == (0, "fanuc_gpio_controller/robot_status_ext")
    received["extended"] = Received(extended, NANOSECONDS)
    for age, mode, drives in ((0.5, MANUAL, Drives.ON), (1.2, OperatingMode.UNKNOWN, Drives.ON),
                              (1.3, OperatingMode.UNKNOWN, Drives.UNKNOWN)):  # fmt: skip
        report = assemble(adapter, received, NANOSECONDS + round(age * NANOSECONDS))
        assert (report.status.operating_mode, report.status.drives) == (mode, drives)
        assert (report.first, report.max_age, report.received_time) == (
            "fanuc_gpio_controller/robot_status", 0.5, NANOSECONDS)  # fmt: skip


@pytest.mark.parametrize("release", ["jazzy", "3.7.0"])
def test_a_robot_without_dashboard_client_tells_what_it_knows(release: str) -> None:
    adapter, vendored = loaded("ur", release)
    kept = ("robot_mode", "safety_mode", "program")
    received = {key: Received(vendored.make(adapter.sources[key].kind, UR[key]), 1) for key in kept}
    assert assemble(adapter, received, 100 * NANOSECONDS).received_time == 0  # nothing comes steadily: no sign of life
    received["scaling"] = Received(vendored.make("std_msgs/msg/Float64", UR["scaling"]), 100 * NANOSECONDS)
    report = assemble(adapter, received, 100 * NANOSECONDS)
    assert (report.status.operating_mode, report.status.drives) == (OperatingMode.UNKNOWN, Drives.ON)
    assert (report.received_time, report.max_age) == (100 * NANOSECONDS, 0.5)


def test_the_stamp_is_the_oldest_there_is() -> None:
    adapter, vendored = loaded("abb", "humble")
    message = vendored.make("abb_robot_msgs/msg/SystemState", {"header": {"stamp": {"sec": 5, "nanosec": 7}}})
    report = assemble(adapter, {"system": Received(message, 10)}, 10)
    assert report.source_time == 5 * NANOSECONDS + 7
    assert report.source == "abb (rws_client/system_states)"


# --- tables ----------------------------------------------------------------------------------------------------------

TABLE = """\
sources:
  plc: {name: plc/state, type: std_msgs/msg/String, max_age: 1.0}
  door: {name: door, type: {std_srvs/srv/Trigger: ""}, max_age: 3.0}
state:
  operating_mode: {read: plc.data, means: {T1: MANUAL_REDUCED}}
  drives: {read: door.success, means: {true: ON, false: OFF}}
  safety:
    - {read: plc.data, means: {HALT: EMERGENCY_STOP, T1: next}}
    - {read: door.success, means: {true: NORMAL, false: SAFEGUARD_STOP}}
"""


def own(folder: Path, text: str) -> Adapter:
    (folder / "plc.yaml").write_text(text, "utf-8")
    return load_adapter(GENERIC, str(folder / "plc.yaml"))


def test_a_table_of_ones_own_with_several_sources(tmp_path: Path) -> None:
    pytest.importorskip("std_srvs.srv")
    adapter = own(tmp_path, TABLE).loaded()
    for word, closed, mode, drives, safety in (
        ("T1", True, REDUCED, Drives.ON, SafetyState.NORMAL),
        ("T1", False, REDUCED, Drives.OFF, SafetyState.SAFEGUARD_STOP),
        ("HALT", True, OperatingMode.UNKNOWN, Drives.ON, SafetyState.EMERGENCY_STOP),
        ("T2", True, OperatingMode.UNKNOWN, Drives.ON, SafetyState.UNKNOWN),
    ):
        said = {"plc": load_type("std_msgs/msg/String")(data=word),
                "door": load_type("std_srvs/srv/Trigger").Response(success=closed)}  # fmt: skip
        found = adapter.translate(said)
        assert (found.operating_mode, found.drives, found.safety) == (mode, drives, safety)


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("MANUAL_REDUCED", "SLOW", r"plc.yaml:5:\d+: state.operating_mode.means.T1: found 'SLOW', expected one of U"),
        ("true: ON,", "true: FAST,", r":6:\d+: state.drives.means.true: found 'FAST', expected one of ON, OFF"),
        ("read: plc.data, means: {T1", "read: plc, means: {T1", r":5:\d+: state.operating_mode: found 'plc'"),
        ("door.success, means: {true: NORMAL", "gate.success, means: {true: NORMAL", ":7:.*state.safety: found 'gate"),
        ("plc.data, means: {T1", "plc.da-ta, means: {T1", "found 'da-ta', expected a field: name"),
        ("max_age: 1.0", "max_age: 11.0", r":2:\d+: sources.plc.max_age: found 11.0, expected less than or"),
        ("max_age: 1.0", "max_age: yes", r":2:\d+: sources.plc.max_age"),
        ("max_age: 1.0", "max_age: null", "expected a topic with max_age, the driver's sign of life"),
        (", max_age: 1.0", "", r":2:\d+: sources.plc.max_age: found nothing, expected a value"),
        ("name: plc/state", "name: /plc/state", r":2:\d+: sources.plc.name: found '/plc/state'"),
        ("std_msgs/msg/String", "String", r":2:\d+: sources.plc.type: found 'String', expected package/msg/Name"),
        ("name: door", "topic: door", r":3:\d+: sources.door.(name: found nothing|topic: found an unknown key)"),
        ("  drives:", "  speed:", r"state.drives: found nothing, expected a rule"),
        ("state:\n", "state:\n  colour: {read: plc.data, means: {a: b}}\n", r":5:\d+: state.colour: found an unk"),
        ("means: {T1: MANUAL_REDUCED}", "is: 1", r":5:\d+: state.operating_mode.means: found {}, expected words"),
        ("state:\n", "notes: {LATE: x}\nstate:\n", r"notes.LATE: found an unknown reason"),
        ("sources:", "remote: 7\nsources:", r":1:\d+: remote: found 7"),
        (TABLE, "- 1\n", "expected a table of a driver"),
        (TABLE, "a: [", "expected YAML"),
    ],
)  # fmt: skip
def test_a_table_that_cannot_be_read_is_one_line_with_its_place(tmp_path: Path, old: str, new: str, found: str) -> None:
    assert old in TABLE
    with pytest.raises(InputError, match=found) as error:
        own(tmp_path, TABLE.replace(old, new, 1))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("plc.data, means: {T1", "plc.word, means: {T1", "operating_mode: String without field word"),
        ("std_msgs/msg/String", "std_msgs/msg/Strings", "no such type"),
        ("std_msgs/msg/String", "no_such_msgs/msg/Name", "apt install ros-jazzy-no-such-msgs"),
        ("true: ON,", "RUNNING: ON,", "Trigger_Response without constant RUNNING for success .boolean."),
    ],
)
def test_a_table_that_does_not_fit_the_installed_messages(tmp_path: Path, old: str, new: str, found: str) -> None:
    pytest.importorskip("std_srvs.srv")
    adapter = own(tmp_path, TABLE.replace(old, new, 1))
    with pytest.raises(InputError, match=found):
        adapter.loaded()


@pytest.mark.parametrize("text", ["RobotStatus", "a/b/c", "os;x/msg/Name", "industrial_msgs/msg/RobotStatus"])
def test_types_that_cannot_be_loaded(text: str) -> None:
    with pytest.raises(InputError, match=r"package/msg/Name|built from its source"):
        load_type(text)


def test_a_driver_that_does_not_exist() -> None:
    with pytest.raises(InputError, match="kuka_kss"):
        load_adapter("kuka")
    with pytest.raises(InputError, match=r"robot_state\.table: found nothing"):
        load_adapter(GENERIC)
