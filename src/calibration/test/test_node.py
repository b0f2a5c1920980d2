"""Parameters, diagnostics and the life of a node."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from granted import Granted

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Time
from calibration_interfaces.action import Measure
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from goals import GoalClient
from rclpy.event_handler import EventHandler, PublisherEventCallbacks
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from stand_ins import finish
from std_msgs.msg import String

from calibration.node import (
    CalibrationNode,
    Declared,
    ParameterError,
    check_parameter_files,
    run,
)

TABLE = (
    Declared("rate", 100.0, "Rate, Hz.", low=1.0, high=1000.0, read_only=False),
    Declared("count", 3, "Number of samples.", low=1),
    Declared("unit", "m", "Unit.", choices=("m", "mm"), read_only=False),
    Declared("names", [], "Names."),
    Declared("cell", "", "Cell file.", required=True),
)


def node(context: Any, **values: Any) -> CalibrationNode:
    given = {"cell": "a.yaml", **values}
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    return CalibrationNode("tracker", TABLE, context=context, parameter_overrides=overrides)


def test_values_and_descriptions(context: Any) -> None:
    one = node(context, rate=50.0, names=["a", "b"])
    assert (one.value("rate"), one.value("count"), one.value("names"), one.value("unit")) == (50.0, 3, ["a", "b"], "m")
    assert one.describe_parameter("rate").floating_point_range[0].to_value == 1000.0
    assert one.describe_parameter("cell").read_only
    assert "One of: m, mm." in one.describe_parameter("unit").description


@pytest.mark.parametrize("given", ["", "    names: []", "    names: ['']"])
def test_all_parameters_can_be_read_at_once_and_given_back(context: Any, given: str, tmp_path: Path) -> None:
    """As `ros2 param dump` reads them: one without a value would leave the answer empty."""
    (tmp_path / "given.yaml").write_text(f"tracker:\n  ros__parameters:\n    cell: a.yaml\n{given}\n", "utf-8")
    arguments = ["--ros-args", "--params-file", str(tmp_path / "given.yaml")]
    one = CalibrationNode("tracker", TABLE, context=context, cli_args=arguments)
    assert one.value("names") == []
    names = one.list_parameters([], 0).names
    read = {each.name: each.value for each in one.get_parameters(names)}
    assert read.keys() >= {declared.name for declared in TABLE}
    again = node(context, **{name: read[name] for name in ("rate", "names", "cell")})
    assert again.value("names") == []
    one.destroy_node()
    again.destroy_node()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"raet": 1.0}, ("raet", "an unknown parameter", "rate")),
        ({"rate": 0.5}, ("rate", "0.5", "float from 1.0 to 1000.0")),
        ({"rate": 100}, ("rate", "100", "float")),
        ({"rate": float("nan")}, ("rate",)),
        ({"count": 0}, ("count", "0", "int from 1")),
        ({"unit": "km"}, ("unit", "'km'", "one of m, mm")),
        ({"cell": ""}, ("cell", "nothing", "cell file: --ros-args -p cell:=FILE")),
    ],
)
def test_wrong_parameters_are_errors(context: Any, values: dict[str, Any], words: tuple[str, ...]) -> None:
    with pytest.raises(ParameterError) as caught:
        node(context, **values)
    for word in ("/tracker", *words):
        assert word in str(caught.value)


def test_parameters_at_run_time(context: Any) -> None:
    one = node(context)
    assert one.set_parameters([Parameter("rate", value=20.0)])[0].successful
    assert not one.set_parameters([Parameter("rate", value=0.0)])[0].successful
    assert not one.set_parameters([Parameter("unit", value="km")])[0].successful
    assert not one.set_parameters([Parameter("cell", value="b.yaml")])[0].successful
    assert one.value("rate") == 20.0


def test_parameter_files(tmp_path: Path) -> None:
    file = tmp_path / "ros.yaml"
    file.write_text(
        "tracker: {ros__parameters: {a: 1}}\n/cell/guard: {ros__parameters: {a: 1}}\n/**: {ros__parameters: {}}\n"
    )
    check_parameter_files(["--ros-args", "--params-file", str(file)])
    file.write_text("cell: {traker: {ros__parameters: {a: 1}}}\n")
    with pytest.raises(
        ParameterError, match=r"ros.yaml: cell/traker: found an unknown node, expected one of .*tracker"
    ):
        check_parameter_files(["--params-file", str(file)])
    file.write_text("/**/guard: {ros__parameters: {a: 1}}\n/left/guard: {ros__parameters: {a: 1}}\n")
    check_parameter_files(["--ros-args", "-r", "__ns:=/left", "--params-file", str(file)])
    file.write_text("guard: {ros__parameters: {a: 1}}\n")
    check_parameter_files(["--ros-args", "-r", "__ns:=/", "--params-file", str(file)])
    with pytest.raises(ParameterError, match=r"holds without a namespace alone, expected /\*\*/guard"):
        check_parameter_files(["--ros-args", "-r", "__ns:=/left", "--params-file", str(file)])
    with pytest.raises(ParameterError, match="No such file"):
        check_parameter_files(["--params-file", str(tmp_path / "none.yaml")])


def test_diagnostics_at_change_and_once_a_second(spinning: Any, until: Callable[..., None]) -> None:
    heard: list[DiagnosticArray] = []
    spinning.plain().create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    one = spinning.add(node(spinning.context))
    until(lambda: one.count_subscribers("/diagnostics"))
    until(lambda: heard)
    one.diagnostics.report("tracker/mp1", 2, "silent", {"age": 1.5})
    until(lambda: any(len(array.status) > 1 for array in heard))
    state, status = next(array for array in heard if len(array.status) > 1).status
    assert (state.name, state.level, state.message) == ("tracker: state", DiagnosticStatus.ERROR, "tracker/mp1: silent")
    assert (status.name, status.level, status.message) == ("tracker: tracker/mp1", DiagnosticStatus.ERROR, "silent")
    assert status.values[0].key == "age"
    seen = len(heard)
    one.diagnostics.report("tracker/mp1", 2, "silent", {"age": 1.6})
    watch = Granted()
    one.diagnostics.report("tracker/mp1", 0, "fine")
    until(lambda: len(heard) > seen and heard[-1].status[1].level == DiagnosticStatus.OK)
    assert watch.seconds < 0.9  # it does not wait for the second
    assert (heard[-1].status[0].level, heard[-1].status[0].message) == (DiagnosticStatus.OK, "all is well")


def test_a_node_that_ends_begins_nothing_and_ends_once(spinning: Any) -> None:
    ended: list[bool] = []

    class Doing(CalibrationNode):
        def on_start(self) -> None:
            self.create_action_server(Measure, "~/do", self._on_goal)

        def _on_goal(self, goal: Any) -> Any:
            goal.succeed()
            return Measure.Result()

        def on_end(self) -> None:
            ended.append(self.ending.is_set())

    one = spinning.add(Doing("tracker", (), context=spinning.context))
    do = GoalClient(spinning.plain(), Measure, "tracker/do")
    assert do.wait_for_server(15.0)
    assert finish(do.send_goal_async(Measure.Goal())).accepted
    one.stop()
    one.stop()
    assert ended == [True]
    assert not finish(do.send_goal_async(Measure.Goal())).accepted


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


def test_an_answer_that_comes_at_once_is_not_lost(spinning: Any) -> None:
    """Slow filing: the answers are taken in by the thread that spins while the thread of the test still sends."""

    def on_goal(goal: Any) -> Any:
        goal.succeed()
        return Measure.Result()

    one = spinning.add(node(spinning.context))
    one.create_action_server(Measure, "~/do", on_goal)
    do = GoalClient(spinning.plain(), Measure, "tracker/do")
    assert do.wait_for_server(15.0)
    slow = Slow(do._client_handle)
    do._client_handle = slow
    handle = finish(do.send_goal_async(Measure.Goal()))
    assert handle.accepted
    assert finish(handle.get_result_async()).status == GoalStatus.STATUS_SUCCEEDED
    assert slow.requests == 2


def test_a_wake_carries_no_events_that_nobody_asked_for(spinning: Any) -> None:
    """The executor looks at every event of every topic each time it wakes; rclpy makes two for each by itself."""
    one = spinning.add(node(spinning.context))
    one.create_subscription(String, "words", lambda _: None, 1)
    assert not any(isinstance(each, EventHandler) for each in one.waitables)
    heard = one.create_publisher(String, "w", 1, event_callbacks=PublisherEventCallbacks(matched=lambda _: None))
    assert heard.event_handlers


def test_the_time_of_a_simulation_is_known_to_whom_nobody_spins(context: Any, spinning: Any, until: Any) -> None:
    """It would wake every node a hundred times a second."""
    one = node(context, use_sim_time=True)
    clock = spinning.plain().create_publisher(Clock, "/clock", 1)
    until(clock.get_subscription_count)
    for seconds in (5, 7):
        clock.publish(Clock(clock=Time(sec=seconds)))
        until(lambda seconds=seconds: one.now_ns() == seconds * 10**9)
    one.destroy_node()
    assert one.now_ns() == 7 * 10**9


def test_of_two_of_a_kind_the_younger_one_ends(spinning: Any, until: Callable[..., None]) -> None:
    class Only(CalibrationNode):
        OWNER = "tracker"

    elder = spinning.add(Only("tracker", (), context=spinning.context))
    younger = spinning.add(Only("tracker", (), context=spinning.context))
    until(younger.failed.is_set)
    until(lambda: elder.diagnostics.worst[1].startswith("owner: two trackers: another one is process "))
    assert not elder.failed.is_set()


def test_a_signal_ends_the_node_after_stop() -> None:
    ended: list[str] = []

    class Ending(CalibrationNode):
        def stop(self) -> None:
            assert self.context.ok()
            ended.append("stopped")

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        assert run(lambda: Ending("tracker", ()), []) == 0
    finally:
        timer.join()
        for number, handler in before.items():
            signal.signal(number, handler)
    assert ended == ["stopped"]


def test_a_failing_callback_ends_the_node_with_1(capfd: pytest.CaptureFixture[str]) -> None:
    class Failing(CalibrationNode):
        def __init__(self) -> None:
            super().__init__("tracker", ())
            self.create_timer(0.05, self._fail)

        def _fail(self) -> None:
            message = "deliberate"
            raise RuntimeError(message)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        assert run(Failing, []) == 1
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert "RuntimeError: deliberate" in capfd.readouterr().err


def test_unusable_input_ends_with_2_and_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        assert run(lambda: CalibrationNode("tracker", TABLE), []) == 2
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert capfd.readouterr().err == "/tracker: cell: found nothing, expected cell file: --ros-args -p cell:=FILE\n"
