"""What the page shows of a state: when a load may be confirmed and why not, the checklist, the bars."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import (
    Condition,
    ConditionOverride,
    Conditions,
    MeasurementProgress,
    NodeHealth,
    Permission,
    ProcedureState,
    RobotState,
    SampleCheck,
    State,
)

from calibration.web.view import CONSTANTS, checklist, forgotten, place_of, plain, running, unfinished, view


def loading(**changes: Any) -> State:
    """A load of 1000 N downwards is on, and waits for the operator's word."""
    one = ProcedureState(
        state=ProcedureState.LOADING, waits_for=ProcedureState.OPERATOR, configuration=7, step=1, steps=4,
        configurations_total=18, load_awaited=True, load_felt_known=True, band_force=25.0, band_angle=0.1,
        seconds_left=math.nan, averaged=math.nan,
    )  # fmt: skip
    one.target.force.z, one.load_felt.force.z = -1000.0, -1010.0
    for name, value in changes.items():
        setattr(one, name, value)
    return State(
        procedure=one, procedure_known=True, permission_known=True, permission=Permission(permitted=True, speed=0.0)
    )


def against(state: State) -> list[str]:
    found = view(plain(state))["confirm"]
    assert found["offered"] is (not found["against"])
    return list(found["against"])


def test_a_load_that_fits_may_be_confirmed() -> None:
    assert against(loading()) == []


def test_a_load_that_the_sequencer_finds_wrong_may_not_and_a_release_waits_for_a_hand() -> None:
    state = loading(load_fault="force: wanted, found")
    state.procedure.load_felt.force.z = -900.0
    assert against(state) == ["force_too_small"]
    released = loading()
    released.procedure.target.force.z = released.procedure.load_felt.force.z = 0.0
    for one, by_itself in ((loading(), True), (released, False)):
        shown = view(plain(one))["confirm"]
        assert (shown["offered"], shown["by_itself"]) == (True, by_itself)


def test_whatever_else_speaks_against_it_is_said() -> None:
    assert against(loading(load_felt_known=False)) == ["load_not_felt"]
    assert against(loading(load_awaited=False)) == ["no_load_awaited"]
    assert against(loading(waits_for=ProcedureState.LOAD_DEVICE)) == ["no_load_awaited"]
    state = loading()
    state.procedure_known = False
    state.procedure.load_fault = "force: wanted, found"  # once upon a time
    assert against(state) == ["sequencer_silent"]
    state = loading()
    state.permission.speed = 0.01
    state.streams = [SampleCheck(name="mp1", problem=SampleCheck.FROZEN), SampleCheck(name="mp2")]
    assert against(state) == ["stream_frozen", "robot_moves"]


def test_without_a_band_the_operators_word_is_enough() -> None:
    state = loading(band_force=math.nan, band_angle=math.nan, load_felt_known=False)
    assert against(state) == []
    assert not view(plain(state))["confirm"]["by_itself"]


def test_a_view_is_plain_json_whatever_is_not_known() -> None:
    shown = view(plain(State()))
    json.dumps(shown, allow_nan=False)
    assert not shown["permission"]["permitted"]
    assert shown["permission"]["reasons"] == ["guard_silent"]
    assert not running(plain(State()))
    assert running(plain(loading()))


def test_constants_become_words_and_every_one_has_its_own() -> None:
    for fields in CONSTANTS.values():
        for words in fields.values():
            assert len(set(words.values())) == len(words) > 1
    state = loading()
    state.permission.permitted = False
    state.permission.reasons = [Permission.DRIVES_OFF, Permission.LATCHED]
    state.robot = RobotState(operating_mode=RobotState.MODE_AUTOMATIC, drives=RobotState.DRIVES_ON)
    shown = view(plain(state))
    assert shown["permission"]["reasons"] == ["drives_off", "latched"]
    assert (shown["robot"]["operating_mode"], shown["robot"]["drives"]) == ("automatic", "on")
    assert (shown["procedure"]["state"], shown["procedure"]["waits_for"]) == ("loading", "operator")


def test_a_load_step_has_a_place_of_its_own() -> None:
    places = [place_of(plain(loading(**change))) for change in ({}, {"step": 2}, {"attempt": 1}, {"configuration": 8})]
    released = loading()
    released.procedure.target.force.z = 0.0
    assert len({*places, place_of(plain(released))}) == 5


def active(name: str, age: float = 0.1) -> NodeHealth:
    return NodeHealth(name=name, level=NodeHealth.OK, age=age)


NODES = ("guard", "sequencer", "tracker", "force_torque", "recorder")


def heard(*silent: str) -> dict[str, Any]:
    """What of a state is shown as current while some nodes are silent: none of them has been missed yet."""
    state = loading(state=ProcedureState.READING, averaged=0.4)
    state.nodes = [active(name, 0.8 if name in silent else 0.3) for name in NODES]
    state.procedure_known, state.permission_known = "sequencer" not in silent, "guard" not in silent
    state.robot = RobotState(operating_mode=RobotState.MODE_MANUAL_REDUCED, drives=RobotState.DRIVES_ON)
    state.streams = [SampleCheck(name="mp1"), SampleCheck(name="wrench")]
    told = forgotten(plain(state)) if "manager" in silent else plain(state)
    shown = view(told)
    rows = {one["name"]: one["met"] for one in checklist(shown, 1e11, (True, ""))}
    current = {
        "permission": shown["permission"]["permitted"], "banner": shown["permission"]["known"],
        "permission row": rows["permission"], "speed": shown["permission"]["speed"] is not None,
        "mode": rows["mode"], "drives": rows["drives"], "felt": shown["load"]["felt"] is not None,
        "confirm": shown["confirm"]["offered"], "averaged": shown["procedure"]["averaged"] is not None,
        "running": shown["running"], "mp1": rows["stream_mp1"], "wrench": rows["stream_wrench"],
        "recorder": rows["recorder_hears"], **{name: rows[f"node_{name}"] for name in NODES},
    }  # fmt: skip
    assert set(current.values()) <= {True, False, None}
    return {name for name, value in current.items() if not value}


@pytest.mark.parametrize(
    ("silent", "unknown"),
    [
        ("none", set()),
        ("guard", {"permission", "banner", "permission row", "speed", "mode", "drives"}),
        ("sequencer", {"felt", "confirm", "averaged", "running"}),
        ("tracker", {"mp1", "averaged", "confirm"}),
        ("force_torque", {"wrench", "felt", "averaged", "confirm"}),
        ("recorder", {"recorder"}),
    ],
)
def test_what_a_silent_node_has_said_is_not_shown_as_current(silent: str, unknown: set[str]) -> None:
    assert heard(silent) == unknown | ({silent} & set(NODES))


def test_of_a_silent_manager_nothing_is_shown_as_current() -> None:
    everything = set().union(*(heard(one) for one in NODES))
    assert heard("manager") == everything
    assert heard(*NODES) == everything


def test_a_run_that_ended_early_can_be_gone_on_with(tmp_path: Path) -> None:
    places = {"session": str(tmp_path / "a1"), "plan": str(tmp_path / "short" / "plan.yaml")}
    going = {"session": "a1", "plan": "short/plan.yaml"}

    def found(last: dict[str, str] | None = None, known: bool = True, **changes: Any) -> dict[str, str] | None:
        state = loading(**places | changes)
        state.procedure_known = known
        return unfinished(plain(state), tmp_path, last)

    assert found() == going
    assert found(state=ProcedureState.FINISHED) == going
    assert found(configurations_done=18) is None
    assert found(configurations_total=0) is None  # it was refused, or is being prepared
    assert found(going, session="") == going  # another process of the sequencer, which knows of no run
    assert found(going, known=False) == going
    assert found(session="/elsewhere/a1") is None


def rows(state: State, **seen: Any) -> dict[str, Any]:
    given = {"disk_free": 1e11, "recorder": (True, "")} | seen
    return {one["name"]: one["met"] for one in checklist(view(plain(state)), given["disk_free"], given["recorder"])}


def test_the_checklist_says_what_is_in_order_what_is_not_and_what_is_not_known() -> None:
    state = loading()
    state.nodes = [active("guard"), NodeHealth(name="tracker", level=NodeHealth.SILENT)]
    state.robot = RobotState(operating_mode=RobotState.MODE_MANUAL_REDUCED, drives=RobotState.DRIVES_OFF)
    state.streams = [SampleCheck(name="mp1"), SampleCheck(name="wrench", problem=SampleCheck.SILENT)]
    override = ConditionOverride(condition="rated_load", operator_name="Ann", reason="agreed")
    state.conditions = Conditions(
        conditions=[
            Condition(name="temperature", verdict=Condition.VIOLATED),
            Condition(name="rated_load", verdict=Condition.VIOLATED, override=override),
            Condition(name="start_up", verdict=Condition.UNKNOWN),
        ]
    )
    found = rows(state)
    good = {"node_guard", "mode", "permission", "stream_mp1", "recorder_hears", "disk", "condition_rated_load"}
    bad = {"node_tracker", "drives", "stream_wrench", "condition_temperature"}
    assert {name for name, met in found.items() if met is True} == good
    assert {name for name, met in found.items() if met is False} == bad
    assert found["condition_start_up"] is None
    assert rows(state, disk_free=1e9)["disk"] is False
    assert rows(state, disk_free=None)["disk"] is None
    assert rows(state, recorder=None)["recorder_hears"] is None
    assert rows(state, recorder=(False, "nothing is heard yet of /tracker/mp1"))["recorder_hears"] is False


def test_a_stop_that_is_proven_before_the_first_motion_is_nothing_to_put_right() -> None:
    state = loading()
    state.permission.permitted, state.permission.reasons = False, [Permission.STOP_UNPROVEN]
    assert rows(state)["permission"] is True
    state.permission.reasons = [Permission.STOP_UNPROVEN, Permission.DRIVES_OFF]
    assert rows(state)["permission"] is False


def test_bars_grow_towards_what_is_wanted_or_expected() -> None:
    state = loading()
    state.progress = MeasurementProgress(
        joints=["a", "b", "c"], stiffness=[1e6, math.nan, 1e6], accuracy=[0.04, math.nan, 0.01],
        expected=[0.01, 0.02, 0.02], wanted=0.02,
    )  # fmt: skip
    bars = view(plain(state))["bars"]
    assert [one["share"] for one in bars] == [0.5, None, 1.0]
    state.progress.wanted = 0.0
    assert [one["share"] for one in view(plain(state))["bars"]] == [0.25, None, 1.0]


def test_how_far_an_average_is_is_told_while_one_is_taken() -> None:
    assert view(plain(loading()))["procedure"]["averaged"] is None
    shown = view(plain(loading(state=ProcedureState.READING, averaged=0.4)))
    assert shown["procedure"]["averaged"] == pytest.approx(0.4)
