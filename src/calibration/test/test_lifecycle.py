"""Managed nodes: the table is that of rcl, what is impossible is answered, what fails is told, inactive is inactive."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from action_msgs.msg import GoalStatus
from calibration_interfaces.action import Measure
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import Tare
from goals import GoalClient
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.event_handler import EventHandler, PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from stand_ins import call, finish
from std_msgs.msg import String
from std_srvs.srv import Trigger

from calibration.lifecycle import machine
from calibration.lifecycle.machine import ASKED, GRAPH, LABELS, Machine
from calibration.lifecycle.managed import TransitionError
from calibration.node import CalibrationNode

KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Probe(CalibrationNode):
    """A node whose transitions do as the test says."""

    def __init__(self, *, autostart: bool = False, **kwargs: Any) -> None:
        self.done: list[str] = []
        self.raising: dict[str, Exception] = {}
        self.release = threading.Event()
        self.release.set()
        self.heard: list[str] = []
        self.ticks = 0
        super().__init__("probe", (), parameter_overrides=[Parameter("autostart", value=autostart)], **kwargs)

    def _step(self, name: str) -> None:
        self.done.append(name)
        self.release.wait(10.0)
        if name in self.raising:
            raise self.raising[name]

    def on_configure(self) -> None:
        self.create_service(Trigger, "~/ask", self._on_ask)
        self.create_service(Tare, "~/judge", self._on_judge)
        self.create_action_server(Measure, "~/do", self._on_goal)
        self.answers = self.create_publisher(String, "~/answers", 10)
        self._step("configure")

    def on_activate(self) -> None:
        self.create_subscription(String, "words", lambda message: self.heard.append(message.data), KEPT)
        self.create_timer(0.01, self._tick)
        self._step("activate")

    def on_deactivate(self) -> None:
        self._step("deactivate")

    def on_cleanup(self) -> None:
        self._step("cleanup")

    def _tick(self) -> None:
        self.ticks += 1

    def _on_ask(self, _request: Any, response: Any) -> Any:
        response.success = True
        return response

    async def _on_judge(self, _request: Any, response: Any) -> Any:
        return response

    def _on_goal(self, goal: Any) -> Any:
        goal.succeed()
        return Measure.Result()


class Slow:
    """The handle of an action client that is slow to tell the number of what it has sent."""

    def __init__(self, handle: Any) -> None:
        self._handle = handle
        self.requests = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._handle, name)

    def _slowly(self, number: int) -> int:
        self.requests += 1
        time.sleep(0.3)
        return number

    def send_goal_request(self, request: Any) -> int:
        return self._slowly(self._handle.send_goal_request(request))

    def send_result_request(self, request: Any) -> int:
        return self._slowly(self._handle.send_result_request(request))


class Remote:
    """The services of a managed node, as `ros2 lifecycle` calls them."""

    def __init__(self, spinning: Any, name: str = "probe") -> None:
        self.node = spinning.plain("remote")
        self._change = self.node.create_client(ChangeState, f"{name}/change_state")
        self._state = self.node.create_client(GetState, f"{name}/get_state")
        self._states = self.node.create_client(GetAvailableStates, f"{name}/get_available_states")
        self._possible = self.node.create_client(GetAvailableTransitions, f"{name}/get_available_transitions")
        self._graph = self.node.create_client(GetAvailableTransitions, f"{name}/get_transition_graph")
        self.events: list[TransitionEvent] = []
        self.node.create_subscription(TransitionEvent, f"{name}/transition_event", self.events.append, 10)

    def change(self, number: int = 0, label: str = "") -> bool:
        request = ChangeState.Request(transition=Transition(id=number, label=label))
        return bool(call(self._change, request).success)

    @property
    def state(self) -> str:
        return str(call(self._state, GetState.Request()).current_state.label)

    @property
    def states(self) -> list[tuple[int, str]]:
        return [(one.id, one.label) for one in call(self._states, GetAvailableStates.Request()).available_states]

    def _edges(self, client: Any) -> list[tuple[int, str, int, int]]:
        answer = call(client, GetAvailableTransitions.Request()).available_transitions
        return [(one.transition.id, one.transition.label, one.start_state.id, one.goal_state.id) for one in answer]

    @property
    def possible(self) -> list[tuple[int, str, int, int]]:
        return self._edges(self._possible)

    @property
    def graph(self) -> list[tuple[int, str, int, int]]:
        return self._edges(self._graph)


@pytest.fixture
def probe(spinning: Any) -> Probe:
    one: Probe = spinning.add(Probe(context=spinning.context))
    return one


@pytest.fixture
def remote(spinning: Any, probe: Probe) -> Remote:  # the node that is asked
    return Remote(spinning)


def test_the_table_is_that_of_rcl(context: Any) -> None:
    node = LifecycleNode("of_rcl", context=context)
    of_rcl = node._state_machine
    assert sorted(LABELS.items()) == sorted(of_rcl.available_states)
    graph = {(one.id, one.label, one.start, LABELS[one.start], one.goal, LABELS[one.goal]) for one in GRAPH}
    assert graph == set(of_rcl.transition_graph)
    ours = Machine()
    triggers = (node.trigger_configure, node.trigger_activate, node.trigger_deactivate, node.trigger_cleanup)
    for trigger, number in zip(triggers, (1, 3, 4, 2), strict=True):
        assert {one.id for one in ours.available} == {one[0] for one in of_rcl.available_transitions}
        trigger()
        assert ours.begin(number) is not None
        ours.end(success=True)
        assert ours.state == of_rcl.current_state[0]
    node.destroy_node()


def test_numbers_are_those_of_the_messages() -> None:
    assert (machine.UNCONFIGURED, machine.INACTIVE, machine.ACTIVE, machine.FINALIZED) == (
        State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE,
        State.PRIMARY_STATE_FINALIZED,
    )  # fmt: skip
    assert machine.DEACTIVATING == State.TRANSITION_STATE_DEACTIVATING
    assert {one.id for one in ASKED} == {1, 2, 3, 4, 5, 6, 7}


def test_a_whole_life_with_its_services_and_events(probe: Probe, remote: Remote, until: Callable[..., None]) -> None:
    until(lambda: probe.count_subscribers("probe/transition_event"))
    assert remote.state == "unconfigured"
    assert remote.states == list(LABELS.items())
    assert remote.graph == [(one.id, one.label, one.start, one.goal) for one in GRAPH]
    assert remote.possible == [(1, "configure", 1, 10), (5, "shutdown", 1, 12)]
    for number, label, state in (
        (Transition.TRANSITION_CONFIGURE, "configure", "inactive"),
        (Transition.TRANSITION_ACTIVATE, "activate", "active"),
        (Transition.TRANSITION_DEACTIVATE, "deactivate", "inactive"),
        (Transition.TRANSITION_CLEANUP, "cleanup", "unconfigured"),
    ):
        assert remote.change(number)
        assert (probe.done[-1], remote.state) == (label, state)
    assert remote.change(label="configure")
    assert remote.change(label="activate")
    assert remote.change(label="shutdown")
    assert probe.done[-2:] == ["deactivate", "cleanup"]
    assert remote.state == "finalized"
    assert remote.possible == []
    until(lambda: len(remote.events) == 14)
    first = remote.events[:2]
    assert [(one.transition.label, one.start_state.label, one.goal_state.label) for one in first] == [
        ("configure", "unconfigured", "configuring"),
        ("transition_success", "configuring", "inactive"),
    ]


STATES: dict[str, tuple[int, ...]] = {"unconfigured": (), "inactive": (1,), "active": (1, 3), "finalized": (5,)}


@pytest.mark.parametrize("state", STATES)
def test_what_is_not_possible_is_answered_and_changes_nothing(probe: Probe, remote: Remote, state: str) -> None:
    for number in STATES[state]:
        assert remote.change(number)
    before = list(probe.done)
    possible = {one.id for one in ASKED if LABELS[one.start] == state}
    for number in {*range(9), 10, 11, 12, 60, 61, 62, 97, 98, 99, 255} - possible:
        assert not remote.change(number), number
    for label in ("configure", "cleanup", "activate", "deactivate", "nonsense", "transition_success"):
        if label not in {one.label for one in ASKED if LABELS[one.start] == state}:
            assert not remote.change(label=label), label
    assert (remote.state, probe.done) == (state, before)


@pytest.mark.parametrize(
    ("callback", "way", "asked", "stays"),
    [
        ("configure", (), 1, "unconfigured"),
        ("activate", (1,), 3, "inactive"),
        ("deactivate", (1, 3), 4, "active"),
        ("cleanup", (1,), 2, "inactive"),
    ],
)
@pytest.mark.parametrize("error", [RuntimeError("deliberate"), TransitionError("deliberate")])
def test_what_raises_is_told_and_leaves_the_node_where_it_was(
    probe: Probe, remote: Remote, capfd: pytest.CaptureFixture[str], callback: str, way: tuple[int, ...], asked: int,
    stays: str, error: Exception,
) -> None:  # fmt: skip
    for number in way:
        assert remote.change(number)
    probe.raising[callback] = error
    assert not remote.change(asked)
    assert remote.state == stays
    assert "deliberate" in probe.trouble
    told = capfd.readouterr().err
    assert "deliberate" in told
    assert ("Traceback" in told) is isinstance(error, RuntimeError)
    probe.raising.clear()
    assert remote.change(asked)
    assert probe.trouble == ""


def test_a_failed_configuration_leaves_nothing_behind(probe: Probe, remote: Remote) -> None:
    before = probe._entities()
    probe.raising["configure"] = RuntimeError("deliberate")
    assert not remote.change(1)
    assert probe._entities() == before
    probe.raising.clear()
    for _ in range(3):
        assert remote.change(1)
        inside = len(probe._entities())
        assert inside > len(before)
        assert remote.change(3)
        assert len(probe._entities()) > inside
        assert remote.change(4)
        assert len(probe._entities()) == inside
        assert remote.change(2)
        assert probe._entities() == before


def test_a_slow_transition_blocks_nothing_and_is_the_only_one(
    probe: Probe, remote: Remote, until: Callable[..., None]
) -> None:
    probe.release.clear()
    slow = remote._change.call_async(ChangeState.Request(transition=Transition(id=1)))
    until(lambda: probe.done)
    began = time.monotonic()
    assert remote.state == "configuring"
    assert not remote.change(1)
    assert not remote.change(5)
    assert time.monotonic() - began < 5.0
    assert not slow.done()
    probe.release.set()
    assert finish(slow).success
    assert remote.state == "inactive"


def test_inactive_is_inactive(probe: Probe, remote: Remote, until: Callable[..., None]) -> None:
    words = remote.node.create_publisher(String, "words", KEPT)
    words.publish(String(data="kept for latecomers"))
    ask = remote.node.create_client(Trigger, "probe/ask")
    judge = remote.node.create_client(Tare, "probe/judge")
    do = GoalClient(remote.node, Measure, "probe/do")
    assert remote.change(1)

    def refused() -> None:
        answer = call(ask, Trigger.Request())
        assert (answer.success, answer.message) == (False, "/probe is inactive, not active")
        outcome = call(judge, Tare.Request()).outcome
        assert (outcome.code, outcome.text) == (Outcome.NOT_AVAILABLE, "/probe is inactive, not active")
        assert do.wait_for_server(15.0)
        assert not finish(do.send_goal_async(Measure.Goal())).accepted
        ticks, heard = probe.ticks, len(probe.heard)
        words.publish(String(data="unheard"))
        time.sleep(0.1)
        assert (probe.ticks, len(probe.heard)) == (ticks, heard)

    refused()
    words.publish(String(data="kept for latecomers"))
    assert remote.change(3)
    until(lambda: probe.heard == ["kept for latecomers"])
    until(lambda: probe.ticks)
    assert call(ask, Trigger.Request()).success
    assert call(judge, Tare.Request()).outcome.code == Outcome.OK
    assert finish(do.send_goal_async(Measure.Goal())).accepted
    assert remote.change(4)
    refused()


def test_an_answer_that_comes_at_once_is_not_lost(probe: Probe, remote: Remote) -> None:
    """Slow filing: the answers are taken in by the thread that spins while the thread of the test still sends."""
    do = GoalClient(remote.node, Measure, "probe/do")
    assert remote.change(1)
    assert remote.change(3)
    assert do.wait_for_server(15.0)
    slow = Slow(do._client_handle)
    do._client_handle = slow
    handle = finish(do.send_goal_async(Measure.Goal()))
    assert handle.accepted
    assert finish(handle.get_result_async()).status == GoalStatus.STATUS_SUCCEEDED
    assert slow.requests == 2


def test_a_wake_carries_no_events_that_nobody_asked_for(spinning: Any) -> None:
    """The executor looks at every event of every topic each time it wakes; rclpy makes two for each by itself."""
    node = spinning.add(Probe(autostart=True, context=spinning.context))
    assert [one for one in node.waitables if isinstance(one, EventHandler)] == []
    heard = node.create_publisher(String, "w", 1, event_callbacks=PublisherEventCallbacks(matched=lambda _: None))
    assert heard.event_handlers


def test_by_itself_a_node_becomes_active(spinning: Any) -> None:
    node = spinning.add(Probe(autostart=True, context=spinning.context))
    assert (node.done, node.active) == (["configure", "activate"], True)
    assert Remote(spinning).state == "active"
    node.stop()
    assert node.done[2:] == ["deactivate", "cleanup"]


def test_what_ends_a_process_gives_everything_back_even_if_the_work_does_not_end(probe: Probe, remote: Remote) -> None:
    assert remote.change(1)
    assert remote.change(3)
    probe.raising["deactivate"] = TransitionError("the robot does not stand")
    probe.stop()
    assert probe.done[2:] == ["deactivate", "cleanup"]
