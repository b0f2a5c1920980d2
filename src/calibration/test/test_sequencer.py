"""The sequencer as a node: what the operator can say, and a measurement in which the operator moves and loads."""

from __future__ import annotations

import math
import shutil
import sys
import threading
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

import re

import pytest
from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import (
    Condition,
    ConditionOverride,
    MeasurementStep,
    Outcome,
    ProcedureState,
    SampleCheck,
    SessionEvent,
)
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from sequencer_world import CELL, GOAL, JOINTS, PULL, Operator, World, ended, overrides
from std_msgs.msg import String

from calibration.cell.port import logged
from calibration.sequencer.goal import Goal, Request
from calibration.sequencer.operator_services import HELD, OperatorServices
from calibration.sequencer.parameters import PARAMETERS, motion_limits
from calibration.sequencer.runner import Call
from calibration.sequencer.sequencer import SequencerNode
from calibration.topics import PROCEDURE, PROGRESS, SAMPLE_CHECK, Quality, profile
from calibration_core.cell import Safety, load_cell
from calibration_core.errors import InputError, SessionGoneError
from calibration_core.files.yaml_file import yaml_text
from calibration_core.measurement import messages as m
from calibration_core.measurement.session import Session
from calibration_core.recording.session import read_session
from calibration_core.recording.session_values import Event


@pytest.mark.parametrize(("asked", "planned"), [(0.25, 0.2), (0.1, 0.1)])
def test_no_motion_is_planned_faster_than_the_declared_limit(asked: float, planned: float) -> None:
    class Given:
        def value(self, name: str) -> Any:
            return asked if name == "motion.speed" else next(p.default for p in PARAMETERS if p.name == name)

    cell = load_cell(CELL)
    assert motion_limits(Given(), cell).speed == asked
    declaring = cell.model_copy(update={"safety": Safety(speed_limit=0.2, source="checksum 8A3F")})
    assert motion_limits(Given(), declaring).speed == planned


def test_parameters_of_a_run_change_between_runs_alone(spinning: Any) -> None:
    usual = {"cell": str(CELL), "motion.backend": "external", "force_torque": "", "recorder": "", "progress": False}
    given = [Parameter(name, value=value) for name, value in usual.items()]
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=given))
    assert node.set_parameters([Parameter("settle_time", value=2.5)])[0].successful
    assert not node.set_parameters([Parameter("settle_time", value=-1.0)])[0].successful
    assert not node.set_parameters([Parameter("permission_age", value=0.9)])[0].successful
    node.runs.goal = Goal(None, lambda: None)  # as while a plan is measured
    answer = node.set_parameters([Parameter("settle_time", value=0.0)])[0]
    assert (answer.successful, answer.reason) == (False, "settle_time: not now: a plan is being measured")
    node.runs.goal = None
    assert node.value("settle_time") == 2.5


@pytest.fixture
def world(spinning: Any) -> World:
    return World(spinning)


@pytest.fixture
def operator(spinning: Any) -> Operator:
    return Operator(spinning)


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.yaml"
    configurations = [{"number": 7, "q": GOAL, "steps": [[0.0] * 6, PULL]}]
    path.write_text(yaml_text({"schema": 1, "joints": JOINTS, "configurations": configurations}))
    return path


def test_without_a_run_there_is_nothing_to_say(spinning: Any, operator: Operator) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    for name in ("pause", "resume", "stop"):
        answer = operator.says(name)
        assert (answer.success, answer.message) == (False, "no plan is being measured")
    assert operator.loaded(1, 0).code == Outcome.INPUT_UNUSABLE


def test_the_operator_moves_and_loads(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: operator.steps)
    assert (operator.steps[0].configuration, operator.steps[0].phase) == (7, MeasurementStep.MOVING)
    assert "a plan is being measured" in operator.rejected(until, plan, tmp_path / "other")
    world.q = np.array(GOAL)  # by the pendant
    until(lambda: any(step.phase == MeasurementStep.LOADING for step in operator.steps))
    assert "step 1 is waited for" in operator.loaded(7, 3).text
    assert "name" in operator.loaded(7, 1, name=" ").text
    assert operator.loaded(7, 1).code == Outcome.OK
    until(lambda: operator.steps[-1].phase == MeasurementStep.UNLOADING)
    assert operator.loaded(7, 1).code == Outcome.OK
    result = ended(handle)
    assert (result.outcome.code, result.configurations_done, result.readings) == (Outcome.OK, 1, 6)
    until(lambda: len(operator.readings) == 6)
    one = operator.readings[-1]
    assert (one.configuration, one.step, one.has_wrench, one.temperature) == (7, 1, False, 21.5)
    assert list(one.q) == pytest.approx(GOAL)
    with Session.look(tmp_path / "session") as session:
        assert session.completed == (7,)
        assert len(session.confirmed()) == 6
        assert session.runs[0]["parameter motion.backend"] == "external"
        assert any(decision.permitted for decision in session.decisions)


def test_it_is_told_how_far_an_average_is(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    world.average = 1.0
    handle = operator.measure(plan, tmp_path / "session")
    world.q = np.array(GOAL)
    until(lambda: operator.loaded(7, 1).code == Outcome.OK)
    until(lambda: operator.loaded(7, 1).code == Outcome.OK)
    assert ended(handle).outcome.code == Outcome.OK
    told = [one.averaged for one in operator.states if one.state == ProcedureState.READING]
    assert 0.5 in told
    assert all(share in (0.0, 0.5) or math.isnan(share) for share in told)  # by its end nothing is averaged
    assert all(math.isnan(one.averaged) for one in operator.states if one.state != ProcedureState.READING)


def test_a_point_that_the_operator_leaves_out_stays_out_of_the_posture(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    why = "by A. Smith: the cable hides it"
    world.average, world.excluded = 0.5, {"mp2": why}
    handle = operator.measure(plan, tmp_path / "session")
    world.q = np.array(GOAL)
    until(lambda: operator.loaded(7, 1).code == Outcome.OK)
    until(lambda: operator.loaded(7, 1).code == Outcome.OK)
    result = ended(handle)
    assert (result.outcome.code, result.readings) == (Outcome.OK, 4)
    assert world.asked == [["mp1", "mp2", "mp3"], ["mp1", "mp3"]]
    excluded = [(one.configuration, one.text) for one in operator.events if one.kind == SessionEvent.POINT_EXCLUDED]
    assert excluded == [(7, f"mp2 {why}")]
    reading = [one for one in operator.states if one.state == ProcedureState.READING and one.point]
    assert {(one.point, *one.points_left) for one in reading} == {("mp1", "mp2", "mp3"), ("mp1", "mp3")}
    assert list(reading[-1].points_excluded) == ["mp2"]
    found, _ = read_session(tmp_path / "session", load_cell(CELL))
    assert sorted({found.points[one] for one in found.point}) == ["mp1", "mp3"]
    assert ("point_excluded", "configuration 7", f"mp2 {why}") in [(n.kind, n.place, n.text) for n in found.notes]


def test_stop_and_resume_later(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: operator.steps)
    assert operator.says("pause").success
    assert operator.says("resume").success
    world.q = np.array(GOAL)
    until(lambda: operator.states[-1].state == ProcedureState.LOADING)
    assert operator.says("stop").success
    assert ended(handle).outcome.code == Outcome.STOPPED
    assert "resume to continue" in operator.rejected(until, plan, tmp_path / "session")
    handle = operator.measure(plan, tmp_path / "session", resume=True)
    until(lambda: "release the load that another run may have left on" in operator.states[-1].waiting)
    assert math.isnan(operator.states[-1].band_force)  # nothing is known against which the sensor could be held
    until(lambda: operator.loaded(7, 0).code == Outcome.OK)
    for _ in range(2):
        until(lambda: operator.loaded(7, 1).code == Outcome.OK)
    assert ended(handle).outcome.code == Outcome.OK


class SlowDisk:
    """What a disk does that others keep busy: whoever writes waits until it is free."""

    def __init__(self) -> None:
        self.waits, self._free = threading.Event(), threading.Event()

    def write(self) -> None:
        self.waits.set()
        self._free.wait()

    def free(self) -> None:
        self._free.set()


@pytest.fixture
def slow_disk() -> Iterator[SlowDisk]:
    one = SlowDisk()
    yield one
    one.free()


@pytest.fixture
def busy(
    slow_disk: SlowDisk, spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> tuple[Any, Any, Path]:
    """A motion under way while the runner waits for a disk: node, goal, and where a stop is noted."""
    trace = tmp_path / "trace.csv"
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides(trace=str(trace))))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: node.runner is not None and node.runner.moving)
    node.runner.post(Call(slow_disk.write))
    assert slow_disk.waits.wait(20.0)
    return node, handle, trace


def test_a_silent_guard_stops_a_motion_even_while_a_disk_is_slow(
    slow_disk: SlowDisk, busy: tuple[Any, Any, Path], world: World, until: Any
) -> None:
    _, handle, trace = busy
    world.timer.cancel()
    until(lambda: trace.exists() and trace.read_text())  # it is made first, and written then
    slow_disk.free()
    assert "stop" in trace.read_text()
    handle.cancel_goal_async()
    assert ended(handle).outcome.code == Outcome.CANCELLED


def test_the_operator_stops_a_motion_even_while_a_disk_is_slow(
    slow_disk: SlowDisk, busy: tuple[Any, Any, Path], operator: Operator
) -> None:
    _, handle, trace = busy
    assert operator.says("stop").success
    assert "stop" in trace.read_text()
    slow_disk.free()
    assert ended(handle).outcome.code == Outcome.STOPPED


def test_a_lost_instrument_stops_a_motion_even_while_a_disk_is_slow(
    slow_disk: SlowDisk, busy: tuple[Any, Any, Path], world: World, until: Any
) -> None:
    """It is stopped before the runner can look, which then pauses: nothing moves before the operator says so."""
    node, handle, trace = busy
    check = world.node.create_publisher(SAMPLE_CHECK.message, SAMPLE_CHECK.relative, SAMPLE_CHECK.qos)
    until(check.get_subscription_count)
    check.publish(SampleCheck(name="mp1", problem=SampleCheck.TWO_SOURCES, text="two publishers"))
    until(lambda: trace.exists() and trace.read_text())
    time.sleep(0.2)
    assert trace.read_text().count("stop") == 1
    check.publish(SampleCheck(name="mp1", problem=SampleCheck.FINE))
    until(lambda: not node.equipment.fault(time.monotonic()))
    slow_disk.free()  # the runner looks when nothing is lost any more
    until(lambda: node.runner.sequence.paused)
    handle.cancel_goal_async()
    assert ended(handle).outcome.code == Outcome.CANCELLED


def test_a_run_that_outlives_its_node_ends_without_a_word(context: Any, plan: Path, tmp_path: Path) -> None:
    """The interpreter closes what still waits when the process ends; what it would publish with is gone by then."""
    node = SequencerNode(context=context, parameter_overrides=overrides())
    handle = types.SimpleNamespace(request=RunPlan.Goal(plan=str(plan), session=str(tmp_path / "session")))
    run = node.runs._on_run(Goal(handle, lambda: None), handle)
    run.send(None)  # under way
    node.destroy_node()
    run.close()


HOT = 25.0  # degrees Celsius
WHO = {"operator_name": "A. Smith", "reason": "no cooling today"}


def test_a_violated_condition_refuses_the_run(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path
) -> None:
    world.temperature = HOT
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    result = ended(operator.measure(plan, tmp_path / "session"))
    assert result.outcome.code == Outcome.CONDITION_VIOLATED
    assert result.outcome.text == "temperature (5.1): found 25.0 °C, expected 20 °C ± 2 °C"
    assert not (tmp_path / "session").exists()
    assert not operator.steps


def test_an_override_with_the_goal_stands_in_session_and_messages(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    world.temperature = HOT
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    override = ConditionOverride(condition="temperature", **WHO)
    handle = operator.measure(plan, tmp_path / "session", overrides=[override])
    until(lambda: operator.conditions)
    rows = {one.name: one for one in operator.conditions[-1].conditions}
    assert (rows["temperature"].verdict, rows["temperature"].override) == (Condition.VIOLATED, override)
    assert rows["manual_mode"].verdict == Condition.UNKNOWN
    until(lambda: any(one.kind == SessionEvent.CONDITION_OVERRIDDEN for one in operator.events))
    told = next(one for one in operator.events if one.kind == SessionEvent.CONDITION_OVERRIDDEN)
    assert told.text == "temperature by A. Smith: no cooling today"
    handle.cancel_goal_async()
    assert ended(handle).outcome.code == Outcome.CANCELLED
    with Session.look(tmp_path / "session") as session:
        assert [(one.condition, one.operator) for one in session.overrides] == [("temperature", "A. Smith")]
        last = {one.name: one for one in session.conditions[-1]}
        assert (last["temperature"].met, last["temperature"].override) == (False, session.overrides[0])
    handle = operator.measure(plan, tmp_path / "session", resume=True)  # it goes on counting
    until(lambda: len(operator.conditions) > 1)
    assert operator.says("stop").success
    assert ended(handle).outcome.code == Outcome.STOPPED


def test_a_condition_violated_on_the_way_pauses_until_it_is_overridden(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: node.runner is not None and node.runner.moving)
    world.temperature = HOT
    until(lambda: node.runner.sequence.paused)
    assert any(one.kind == SessionEvent.CONDITION_VIOLATED for one in operator.events)
    assert operator.says("resume").success
    until(lambda: not node.runner.sequence.paused)
    until(lambda: node.runner.sequence.paused)  # still too warm
    assert operator.overrides("temperature").code == Outcome.OK
    until(lambda: any(one.kind == SessionEvent.CONDITION_OVERRIDDEN for one in operator.events))
    assert operator.says("resume").success
    world.q = np.array(GOAL)
    for step in (1, 1):
        until(lambda: operator.loaded(7, step).code == Outcome.OK)  # noqa: B023
    assert ended(handle).outcome.code == Outcome.OK


@pytest.mark.parametrize(
    ("condition", "name", "reason", "text"),
    [
        ("weather", "A. Smith", "rain", "found 'weather', expected one of temperature"),
        ("temperature", " ", "no cooling", "operator_name: found nothing"),
        ("temperature", "A. Smith", "", "reason: found nothing"),
        ("temperature", "A. Smith", "no cooling", "no plan is being measured"),
    ],
)
def test_an_override_that_cannot_be_taken(
    spinning: Any, operator: Operator, condition: str, name: str, reason: str, text: str
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    answer = operator.overrides(condition, name, reason)
    assert answer.code == Outcome.INPUT_UNUSABLE
    assert text in answer.text


def test_a_goal_with_an_unknown_condition_is_refused(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    given = [ConditionOverride(condition="weather", **WHO)]
    assert "weather" in operator.rejected(until, plan, tmp_path / "session", overrides=given)


def test_a_run_can_be_cancelled(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: operator.steps)
    handle.cancel_goal_async()
    assert ended(handle).outcome.code == Outcome.CANCELLED


def test_what_is_missing_is_named(spinning: Any, operator: Operator, plan: Path, tmp_path: Path) -> None:
    given = overrides(**{"server_wait": 0.2, "motion.prepare_services": ["/go=std_srvs/srv/Trigger"]})
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=given))
    result = ended(operator.measure(plan, tmp_path / "session"))
    everything = "/go: no answer; no action server tracker/measure; no joint states on /joint_states"
    assert (result.outcome.code, result.outcome.text) == (Outcome.NO_DATA, everything)
    assert not (tmp_path / "session").exists()


def test_without_joint_states_nothing_begins(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path
) -> None:
    world.timer.cancel()
    given = overrides(server_wait=0.5)
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=given))
    result = ended(operator.measure(plan, tmp_path / "session"))
    assert "/joint_states" in result.outcome.text


@pytest.mark.parametrize(
    ("parameters", "found"),
    [
        ({"cell": ""}, "cell"),
        ({"motion.backend": "telepathy"}, "telepathy"),
        ({"motion.backend": "follow_joint_trajectory"}, "control_msgs"),
        ({"motion.prepare_services": ["go"]}, "go"),
        ({"motion.stop_services": ["/stop=no_such_msgs/srv/Stop"]}, "no_such_msgs"),
        ({"motion.speed": 0.3}, "motion.speed"),
        ({"unheard_of": 1}, "unheard_of"),
    ],
)
def test_parameters_that_cannot_be_used(
    context: Any, monkeypatch: pytest.MonkeyPatch, parameters: dict[str, Any], found: str
) -> None:
    monkeypatch.setitem(sys.modules, "control_msgs", None)
    with pytest.raises(InputError, match=found):
        SequencerNode(context=context, parameter_overrides=overrides(**parameters))


@pytest.mark.parametrize(
    ("record", "line"),
    [
        (m.Record(m.Kind.WARM_UP, 1, 0, ""), "warm up: configuration 1, step 0"),
        (m.Record(m.Kind.REFERENCE, 0, 2, ""), "reference: the reference (configuration 0, step 2)"),
        (m.Record(m.Kind.READING_REJECTED, 3, 1, "it moved"), "reading rejected: configuration 3, step 1: it moved"),
        (m.Record(m.Kind.PAUSED, 0, 0, "by the operator"), "paused: by the operator"),
    ],
)
def test_a_line_of_the_log_says_where(record: m.Record, line: str) -> None:
    assert logged(record) == line


def test_resume_is_refused_while_a_run_begins_with_a_latched_fault() -> None:
    """Motion is resumed by name alone, also where the run has yet to meet the guard's word."""
    said: list[Request] = []
    runs = types.SimpleNamespace(goal=object(), take=lambda request, _: said.append(request))
    watch = types.SimpleNamespace(latched=True)
    node = types.SimpleNamespace(create_service=lambda *_, **__: None, runner=None, runs=runs, watch=watch)
    answer = OperatorServices(node)._on_resume(None, types.SimpleNamespace())
    assert (answer.success, answer.message, said) == (False, HELD, [])


def test_who_comes_late_to_progress_hears_what_is_known_now(spinning: Any, until: Any) -> None:
    speaker = spinning.plain("speaker").create_publisher(PROGRESS.message, PROGRESS.relative, PROGRESS.qos)
    for number in (1, 2, 3):
        speaker.publish(PROGRESS.message(configuration=number))
    heard: list[int] = []
    spinning.plain("late").create_subscription(
        PROGRESS.message, PROGRESS.relative, lambda one: heard.append(one.configuration), profile(Quality.EVENTS)
    )
    until(lambda: heard)
    assert heard == [3]


@pytest.mark.parametrize("how", ["deleted", "moved away"])
def test_a_session_that_is_gone_is_told_at_once_and_nothing_is_read_into_nothing(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any, how: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Where it is put back, the run goes on, and what was told meanwhile stands in it."""
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    session = tmp_path / "session"
    handle = operator.measure(plan, session)
    world.q = np.array(GOAL)
    until(lambda: operator.states and operator.states[-1].state == ProcedureState.LOADING)
    before = len(operator.readings)
    if how == "deleted":
        shutil.rmtree(session)
    else:
        session.rename(tmp_path / "elsewhere")
    until(lambda: operator.states[-1].paused and "session.db is gone" in operator.states[-1].question, timeout=5.0)
    operator.loaded(7, 1)
    assert not operator.says("resume").success or operator.states[-1].paused
    until(lambda: operator.states[-1].paused)
    assert len(operator.readings) == before
    if how == "moved away":
        world.temperature = HOT
        until(lambda: any(one.kind == SessionEvent.CONDITION_VIOLATED for one in operator.events))
        assert operator.overrides("temperature").code == Outcome.OK
        until(lambda: any(one.kind == SessionEvent.CONDITION_OVERRIDDEN for one in operator.events))
        note, tried = Session.note, list[Event]()

        def late(one: Session, event: Event) -> None:
            """They are gone when it is written, and back before anybody looks why it could not be."""
            tried.append(event)
            if len(tried) == 1:
                raise SessionGoneError(one.directory, "", "nothing", "what was left")
            note(one, event)

        monkeypatch.setattr(Session, "note", late)
        (tmp_path / "elsewhere").rename(session)
        until(lambda: operator.says("resume").success and not operator.states[-1].paused)
        until(lambda: operator.steps[-1].phase == MeasurementStep.UNLOADING)
        assert operator.loaded(7, 1).code == Outcome.OK
        assert ended(handle).outcome.code == Outcome.OK
        with Session.look(session) as one:
            assert len(one.confirmed()) == 6
            kinds = [event.kind for event in one.events]
            told = ["paused", "load_applied", "condition_violated", "condition_overridden", "continued"]
            assert sorted(told, key=kinds.index) == told
            assert [override.condition for override in one.overrides] == ["temperature"]
            assert any(row.met is False for table in one.conditions for row in table)
    else:
        assert operator.says("stop").success
        assert ended(handle).outcome.code != Outcome.OK
    assert not (session / "session.db").exists() or how == "moved away"


def test_a_robot_that_was_jogged_is_not_read(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    """By less than the plan allows, yet by more than a load step may differ from the unloaded one."""
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "session")
    world.q = np.array(GOAL)
    until(lambda: operator.states and operator.states[-1].state == ProcedureState.LOADING)
    world.q = np.array([GOAL[0], GOAL[1] + 2e-3, *GOAL[2:]])
    assert operator.loaded(7, 1).code == Outcome.OK
    until(lambda: operator.states[-1].paused)
    asked = operator.states[-1].question
    assert asked.startswith("joint_2: found 0.20200 rad, expected 0.20000 ± 0.00050 rad of step 0")
    assert len(operator.readings) == 3
    assert operator.says("stop").success
    assert ended(handle).outcome.code == Outcome.STOPPED


@pytest.mark.parametrize(
    ("fault", "words"),
    [("exchanged", "mp1 and mp2 are exchanged: look at what the tracker is locked on"),
     ("knocked", "mp1 stands 5.0 mm elsewhere: look at target and beam")],
)  # fmt: skip
def test_targets_pause_the_run_until_they_are_right_or_somebody_answers_for_them(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any, fault: str, words: str
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "session")
    world.q = np.array(GOAL)
    until(lambda: operator.states and operator.states[-1].state == ProcedureState.LOADING)
    world.tracker_fault = fault
    assert operator.loaded(7, 1).code == Outcome.OK
    until(
        lambda: operator.states[-1].paused and operator.states[-1].question.endswith("the configuration begins again")
    )
    assert operator.states[-1].question.startswith(f"{words}: put it right, or override 'targets' by name; then resume")
    assert len(operator.readings) == 3
    assert operator.overrides("targets", reason="").code == Outcome.INPUT_UNUSABLE
    if fault == "exchanged":
        world.tracker_fault = ""
    else:
        assert operator.overrides("targets", reason="it was glued on anew").code == Outcome.OK
    assert operator.says("resume").success
    until(lambda: operator.states[-1].state == ProcedureState.UNLOADING)
    assert operator.loaded(7, 1).code == Outcome.OK
    until(lambda: operator.states[-1].state == ProcedureState.LOADING)
    assert operator.loaded(7, 1).code == Outcome.OK
    until(lambda: operator.states[-1].state == ProcedureState.UNLOADING)
    assert operator.loaded(7, 1).code == Outcome.OK
    assert ended(handle).outcome.code == Outcome.OK
    with Session.look(tmp_path / "session") as session:
        named = [(one.condition, one.operator) for one in session.overrides]
        assert named == [("targets", "A. Smith")] * (fault == "knocked")
        assert [outcome for *_, outcome, _ in session.attempts] == ["given up", "completed"]
        assert len(session.confirmed()) == 6


def test_what_cannot_be_begun_is_rejected(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    assert "no/such.yaml" in operator.rejected(until, tmp_path / "no" / "such.yaml", tmp_path / "session")
    assert "no session" in operator.rejected(until, plan, tmp_path / "session", resume=True)
    other = tmp_path / "other.yaml"
    other.write_text(plan.read_text().replace("joint_6", "axis_6"))
    assert "expected the cell's joints" in operator.rejected(until, other, tmp_path / "session")
    assert not (tmp_path / "session").exists()


def test_another_robot_than_the_cells_is_not_moved(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    reported: list[str] = []
    world.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda one: reported.extend(str(status.message) for status in one.status), 10
    )
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "first")  # nobody describes the robot: that is reported, and no reason
    until(lambda: node.runner is not None)
    until(lambda: any(text.startswith("nothing comes on /robot_description") for text in reported))
    text = load_cell(CELL).urdf_path.read_text("utf-8")
    described = world.node.create_publisher(String, "robot_description", profile(Quality.STATE))
    described.publish(String(data=text))
    time.sleep(1.5)
    assert not node.runner.sequence.paused
    other = re.sub(r'upper="[^"]*"', 'upper="0.9"', text, count=1)
    described.publish(String(data=other))  # another one, in the middle of a run
    until(lambda: node.runner.sequence.paused)
    until(lambda: "/robot_description is another robot than" in node.runner.sequence.snapshot().question)
    assert "limits of joint_1" in node.runner.sequence.snapshot().question
    assert operator.says("stop").success
    assert ended(handle).outcome.code == Outcome.STOPPED
    refused = operator.rejected(until, plan, tmp_path / "second")
    assert "/robot_description is another robot than" in refused
    described.publish(String(data=text))
    until(lambda: not node._description.fault)
    handle = operator.measure(plan, tmp_path / "second")
    assert handle.accepted
    until(lambda: node.runner is not None)
    assert operator.says("stop").success


def test_after_a_loss_of_permission_motion_is_resumed_by_name(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: node.runner is not None and node.runner.moving)
    world.permitted = False
    until(lambda: node.runner.sequence.held)
    assert operator.moves_on().code == Outcome.NOT_PERMITTED
    world.permitted = True
    until(lambda: operator.moves_on().code == Outcome.OK)
    until(lambda: node.runner.moving and not node.runner.sequence.held)
    world.permitted = False
    until(lambda: node.runner.sequence.held)
    world.permitted = True
    answer = operator.says("resume")
    assert (answer.success, "resume_motion" in answer.message) == (False, True)
    assert "name" in operator.moves_on(" ").text
    time.sleep(0.5)
    assert not node.runner.moving
    until(lambda: operator.moves_on().code == Outcome.OK)
    until(lambda: node.runner.moving)
    assert any(one.kind == SessionEvent.CONTINUED and one.text == "by A. Smith" for one in operator.events)
    handle.cancel_goal_async()
    assert ended(handle).outcome.code == Outcome.CANCELLED


def test_a_goal_accepted_without_permission_waits_for_the_operator(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    """Neither the reset of a latch nor drives that are switched on begin a motion."""
    world.permitted = False
    given = overrides(server_wait=0.5)
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=given))
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: node.runner is not None and node.runner.sequence.held)
    world.permitted = True
    time.sleep(0.5)
    assert not node.runner.moving
    assert operator.moves_on().code == Outcome.OK
    until(lambda: node.runner.moving)
    handle.cancel_goal_async()
    assert ended(handle).outcome.code == Outcome.CANCELLED


def test_a_client_that_is_gone_pauses_the_run(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    operator.measure(plan, tmp_path / "session")
    until(lambda: node.runner is not None and node.runner.moving)
    time.sleep(0.5)
    assert not node.runner.sequence.paused
    operator.plan.destroy()
    until(lambda: node.runner.sequence.paused)
    assert operator.says("resume").success
    until(lambda: node.runner.moving)  # the operator minds it
    time.sleep(0.5)
    assert not node.runner.sequence.paused
    assert operator.says("stop").success
    until(lambda: node.runner is None)


def test_a_wrench_that_two_publish_pauses_the_run(
    spinning: Any, world: World, operator: Operator, plan: Path, tmp_path: Path, until: Any
) -> None:
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides()))
    checks = world.node.create_publisher(SAMPLE_CHECK.message, SAMPLE_CHECK.relative, SAMPLE_CHECK.qos)
    heard: list[Any] = []
    world.node.create_subscription(PROCEDURE.message, PROCEDURE.relative, heard.append, PROCEDURE.qos)
    handle = operator.measure(plan, tmp_path / "session")
    until(lambda: operator.steps)
    words = "/input/wrench is published by /driver, /old_driver"
    checks.publish(SampleCheck(name="wrench", problem=SampleCheck.TWO_SOURCES, text=words))
    until(lambda: heard and heard[-1].paused and words in heard[-1].question)
    operator.says("resume")
    time.sleep(0.5)
    assert heard[-1].paused
    checks.publish(SampleCheck(name="wrench", problem=SampleCheck.FINE))
    until(lambda: not node.equipment.fault(time.monotonic()))
    assert operator.says("resume").success
    until(lambda: not heard[-1].paused)
    assert operator.says("stop").success
    assert ended(handle).outcome.code == Outcome.STOPPED
