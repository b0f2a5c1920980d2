"""The state of the cell: how a run stands, what is wrong, and the way out."""

from __future__ import annotations

import copy
import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.action import Measure
from calibration_interfaces.msg import (
    Condition,
    ConditionOverride,
    Conditions,
    Fault,
    MeasurementProgress,
    NodeHealth,
    Permission,
    ProcedureState,
    Reading,
    SampleCheck,
    State,
)

from calibration import manager as wrong
from calibration.cell.reading_checks import PresentLoad
from calibration.manager import Whole
from calibration.node import LEASE
from calibration.sequencer.feedback import ProcedureReport
from calibration_core.measurement import messages as m
from calibration_core.measurement.sequence import Sequence
from calibration_core.measurement.snapshot import Party, ReadingVerdict, Snapshot
from calibration_core.measurement.target_check import PUT_RIGHT
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration

PULL = np.array([0.0, 0.0, -500.0, 0.0, 0.0, 0.0])
NAMES = ("guard", "sequencer")
NOTHING_READ = SimpleNamespace(averaged=math.nan, under_way=Measure.Feedback(), excluded={})


@dataclasses.dataclass
class Watched:
    """A procedure, and how it stands."""

    sequence: Sequence
    now: float = 0.0
    commands: tuple[Any, ...] = ()

    def tell(self, kind: type, **fields: Any) -> None:
        self.now += 1.0
        event = kind(now=self.now, **fields)
        self.commands = self.sequence.handle(event)

    @property
    def stands(self) -> Snapshot:
        return self.sequence.snapshot()

    def answer(self, kind: type, **fields: Any) -> None:
        request = next(one.request for one in reversed(self.commands) if hasattr(one, "request"))
        self.tell(kind, request=request, **fields)


def procedure(*, by_device: bool = False, loaded: bool = False) -> Watched:
    one = PlannedConfiguration(1, np.full(6, 0.1), np.array([np.zeros(6), PULL]))
    plan = Plan("robot", tuple(f"joint_{i}" for i in range(1, 7)), (one,), np.empty((0, 6)))
    rules = SequenceRules(readings=2, attempts=2, startup_cycles=0)
    return Watched(Sequence(plan, rules, by_device=by_device, loaded=loaded))


@pytest.fixture
def watched() -> Watched:
    return procedure()


def begin(watched: Watched) -> None:
    watched.tell(m.GuardHearing, hears=True)
    watched.tell(m.Start)


def test_a_run_as_people_see_it(watched: Watched) -> None:
    begin(watched)
    assert (watched.stands.waits_for, watched.stands.waiting) == (Party.GUARD, "guard: permission to move")
    watched.tell(m.PermissionChanged, permitted=True)
    if watched.sequence.paused:  # a run may begin held
        watched.tell(m.Resume)
    assert (watched.stands.waits_for, watched.stands.text) == (Party.ROBOT, "moving to configuration 1")
    assert watched.stands.goal == (0.1,) * 6
    watched.answer(m.Arrived)
    assert watched.stands.text == "waiting for standstill at configuration 1, step 1 of 2"
    assert watched.stands.goal == ()
    watched.answer(m.Settled)
    assert (watched.stands.waits_for, watched.stands.waiting) == (Party.INSTRUMENTS, "instruments: a settled window")
    watched.answer(m.ReadingConfirmed)
    assert (watched.stands.reading.verdict, watched.stands.readings) == (ReadingVerdict.KEPT, 1)
    assert watched.stands.load_awaited
    assert (watched.stands.waits_for, watched.stands.waiting) == (
        Party.OPERATOR, "operator: pull with (0, 0, -500) N, then confirm",
    )  # fmt: skip
    watched.answer(m.LoadReached)
    watched.answer(m.Settled)
    watched.answer(m.ReadingFailed, reason="the beam is broken")
    assert (watched.stands.reading.verdict, watched.stands.reading.text) == (
        ReadingVerdict.REPEATED,
        "the beam is broken",
    )
    watched.answer(m.Settled)
    watched.answer(m.ReadingFailed, reason="the beam is broken")
    assert watched.stands.waiting == "operator: release the load, then confirm"
    watched.answer(m.LoadReached)
    assert watched.stands.reading.verdict is ReadingVerdict.GIVEN_UP
    assert (watched.stands.attempt, watched.stands.readings) == (1, 1)
    watched.tell(m.Pause)
    assert watched.stands.waits_for is Party.OPERATOR
    assert watched.stands.text == "paused before the next motion or load step"
    assert "resume" in watched.stands.waiting
    watched.tell(m.Resume)
    assert watched.stands.question == ""
    watched.tell(m.Stop)
    assert (watched.stands.text, watched.stands.waiting) == ("the run is over", "")


def test_a_load_device_is_waited_for() -> None:
    watched = procedure(by_device=True, loaded=True)
    begin(watched)
    assert (watched.stands.waits_for, watched.stands.waiting) == (Party.LOAD_DEVICE, "load device: the load's release")


class Report:
    """A node that keeps what is published."""

    def __init__(self) -> None:
        self.cell = SimpleNamespace(robot=SimpleNamespace(joints=()))
        self.published: list[ProcedureState] = []

    def create_publisher(self, *_: Any) -> Any:
        return SimpleNamespace(publish=lambda one: self.published.append(copy.deepcopy(one)))

    def now_ns(self) -> int:
        return 0


def test_who_resumes_is_told_and_after_the_end_nothing_is_left(watched: Watched) -> None:
    node = Report()
    report = ProcedureReport(node)

    def reported() -> tuple[bool, bool]:
        report.publish(watched.sequence, lambda _: PresentLoad(), NOTHING_READ, moving=False)
        return node.published[-1].paused, node.published[-1].held

    begin(watched)
    watched.tell(m.PermissionChanged, permitted=True)
    assert reported() == (False, False)
    watched.tell(m.Pause)
    assert reported() == (True, False)
    watched.tell(m.Resume)
    watched.tell(m.PermissionChanged, permitted=False, reason="mode")
    assert reported() == (True, True)
    watched.tell(m.PermissionChanged, permitted=True)
    assert reported() == (True, True)  # it is not resumed by itself
    report.ended("the disk is full")
    last = node.published[-1]
    assert (last.state, last.paused, last.held, last.seconds_left) == (ProcedureState.FINISHED, False, False, 0.0)


def test_a_load_of_another_run_is_named() -> None:
    watched = procedure(loaded=True)
    begin(watched)
    assert (watched.stands.waits_for, watched.stands.waiting) == (
        Party.OPERATOR, "operator: release the load that another run may have left on, then confirm",
    )  # fmt: skip
    watched.answer(m.LoadReached)
    assert watched.stands.waits_for is Party.GUARD


def health(name: str, level: int = NodeHealth.OK, text: str = "", identifier: int = 7) -> NodeHealth:
    return NodeHealth(name=name, level=level, text=text, identifier=identifier)


def well() -> State:
    state = State(procedure_known=True, permission_known=True, nodes=[health(name) for name in NAMES])
    state.permission.permitted = True
    return state


def found(state: State) -> list[tuple[int, str, str]]:
    return [(int(one.level), str(one.code), str(one.source)) for one in wrong.faults(state)]


def test_all_is_well() -> None:
    state = well()
    assert wrong.faults(state) == []
    state.permission = Permission(reasons=[Permission.STOP_UNPROVEN], text="the stop is not proven yet")
    assert wrong.faults(state) == []  # a run proves it before its first motion: nobody has to do anything


@pytest.mark.parametrize(
    ("change", "fault", "remedy"),
    [
        ({"nodes": [health("tracker", NodeHealth.SILENT)]}, (Fault.ERROR, "node_silent", "tracker"), "start it again"),
        ({"nodes": [health("guard", NodeHealth.ABSENT)]}, (Fault.ERROR, "node_absent", "guard"), "resume motion"),
        ({"nodes": [health("recorder", NodeHealth.ERROR, text="bag: no room")]},
         (Fault.ERROR, "node_error", "recorder"), ""),
        ({"permission_known": False}, (Fault.ERROR, "guard_silent", "guard"), "start it again"),
        ({"permission": Permission(reasons=[Permission.DRIVES_OFF], text="drives off")},
         (Fault.WARN, "not_permitted", "guard"), "enabling device"),
        ({"permission": Permission(reasons=[Permission.DRIVES_OFF], text="drives off"),
          "procedure": ProcedureState(waits_for=ProcedureState.GUARD)},
         (Fault.ERROR, "not_permitted", "guard"), "enabling device"),
        ({"permission": Permission(reasons=[Permission.STOP_UNPROVEN], text="unproven"),
          "procedure": ProcedureState(state=ProcedureState.READY, waits_for=ProcedureState.GUARD)},
         (Fault.ERROR, "not_permitted", "guard"), "the stop is proven"),
        ({"permission": Permission(latched=True, reasons=[Permission.LATCHED], text="over speed")},
         (Fault.ERROR, "guard_latched", "guard"), "moves nothing"),
        ({"streams": [SampleCheck(name="mp1", topic="/tracker/mp1", problem=SampleCheck.SILENT, text="silent")]},
         (Fault.ERROR, "stream", "mp1"), "lock the beam"),
        ({"conditions": Conditions(conditions=[Condition(name="temperature", verdict=Condition.VIOLATED, shall=True)])},
         (Fault.ERROR, "condition", "temperature"), "override it by name"),
        ({"procedure": ProcedureState(reading_verdict=ProcedureState.REPEATED, reading_text="not settled")},
         (Fault.WARN, "reading_rejected", "sequencer"), "tried again"),
        ({"procedure": ProcedureState(paused=True, question=f"mp1 and mp2 are exchanged: {PUT_RIGHT}")},
         (Fault.ERROR, "condition", "targets"), "override 'targets' by name"),
        ({"progress": MeasurementProgress(suspicious=True, configuration=4)},
         (Fault.WARN, "suspicious", "configuration 4"), "measure it again"),
    ],
)  # fmt: skip
def test_every_fault_has_a_place_and_a_way_out(
    change: dict[str, Any], fault: tuple[int, str, str], remedy: str
) -> None:
    state = well()
    for name, value in change.items():
        setattr(state, name, value)
    assert found(state) == [fault]
    (one,) = wrong.faults(state)
    assert one.text
    assert remedy in one.remedy


def test_what_is_overridden_is_no_fault_and_the_gravest_stands_first() -> None:
    state = well()
    by = ConditionOverride(condition="temperature", operator_name="A. Miller", reason="known")
    state.conditions.conditions = [Condition(name="temperature", verdict=Condition.VIOLATED, shall=True, override=by)]
    assert wrong.faults(state) == []
    state.progress.suspicious = True
    state.nodes = [health("tracker", NodeHealth.SILENT)]
    assert [level for level, _, _ in found(state)] == [Fault.ERROR, Fault.WARN]


def constants(message: type) -> set[int]:
    values = [getattr(message, name) for name in dir(message) if name.isupper()]
    return {value for value in values if isinstance(value, int)}


def test_every_reason_and_problem_of_the_messages_is_answered() -> None:
    assert set(wrong.NOT_PERMITTED) == constants(Permission)
    assert set(wrong.STREAM) == constants(SampleCheck) - {SampleCheck.FINE, SampleCheck.GAP}


def test_the_whole_says_who_is_not_heard_and_what_was_said_last() -> None:
    whole = Whole(NAMES, 0.5)
    state = whole.message(0.0)
    assert (state.procedure_known, state.permission_known) == (False, False)
    assert state.not_permitted == "the guard is silent"
    assert [one.code for one in state.faults] == ["node_absent", "node_absent"]
    for name in NAMES:
        assert whole.hear_node(health(name), 1.0)
    procedure = ProcedureState(text="moving to configuration 3", waiting="robot: arrival")
    assert not whole.message(1.0).procedure_known
    whole.hear("procedure", procedure, 1.0)
    whole.hear("permission", Permission(permitted=True), 1.0)
    state = whole.message(1.1)
    assert (state.text, state.waiting, state.not_permitted) == (procedure.text, procedure.waiting, "")
    assert list(state.faults) == []
    before = whole.news(state)
    assert before == whole.news(whole.message(1.2))
    assert [round(one.age, 1) for one in whole.message(1.3).nodes] == [0.3, 0.3]
    state = whole.message(1.8)  # it is not missed yet, and what it has said is not current any more
    assert (state.procedure_known, [one.code for one in state.faults]) == (False, ["guard_silent"])
    assert whole.news(state) != before
    whole.hear_node(health("guard"), 2.6)
    whole.hear("permission", Permission(permitted=True), 2.6)
    assert whole.silent(2.6) == []
    assert whole.silent(2.7) == ["sequencer"]
    state = whole.message(2.7)
    assert state.text == "the sequencer is not heard; it said last: moving to configuration 3"
    assert [one.code for one in state.faults] == ["node_silent"]
    assert whole.news(state) != before
    assert whole.message(3.2).not_permitted == "the guard is silent"


def test_silence_is_noticed_once_and_ends() -> None:
    whole = Whole(NAMES, 0.5)
    for name in NAMES:
        assert whole.hear_node(health(name), 0.0)
        assert not whole.hear_node(health(name), 0.0)
    assert not whole.hear_node(health("stranger"), 0.0)
    assert whole.silent(LEASE) == []
    whole.hear_node(health("guard"), LEASE)
    assert whole.silent(LEASE + 0.1) == ["sequencer"]
    assert whole.silent(LEASE + 0.2) == []
    assert whole.hear_node(health("sequencer"), LEASE + 0.3)  # it was stopped, and goes on
    assert whole.hear_node(health("sequencer", identifier=8), LEASE + 0.4)  # it was started again
    assert [one.level for one in whole.message(LEASE + 0.5).nodes] == [NodeHealth.OK] * len(NAMES)


def test_a_manager_that_was_busy_itself_hears_the_others_before_it_misses_them() -> None:
    whole = Whole(NAMES, 0.5)
    for name in NAMES:
        whole.hear_node(health(name), 0.0)
    assert whole.silent(0.1) == []
    assert whole.silent(4.0) == []
    whole.hear_node(health("guard"), 4.0)
    assert whole.silent(4.1) == ["sequencer"]


def test_readings_of_another_session_are_named_for_a_while() -> None:
    whole = Whole(NAMES, 0.5)
    for name in NAMES:
        assert whole.hear_node(health(name), 1.0)
    whole.hear("permission", Permission(permitted=True), 1.0)
    whole.hear("procedure", ProcedureState(session="/data/today"), 1.0)
    whole.hear_reading(Reading(session="/data/today@7"), 1.0)
    assert [one.code for one in whole.message(1.1).faults] == []
    whole.hear_reading(Reading(session="/data/last year@3"), 1.0)
    (fault,) = whole.message(1.1).faults
    assert (fault.code, "/data/last year@3" in fault.text) == ("foreign_session", True)
    assert "foreign_session" not in [one.code for one in whole.message(20.0).faults]
