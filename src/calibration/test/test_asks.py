"""A request to another node ends once: answered, refused, late, or not wanted any more."""

from __future__ import annotations

import time
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.action import Measure
from rclpy.action import ActionServer, GoalResponse
from std_srvs.srv import Trigger

from calibration.asks import Server

Said = list[tuple[Any, str]]


def test_a_service_answers(spinning: Any, until: Any) -> None:
    node, said = spinning.plain("asker"), Said()
    answer = Trigger.Response(success=True)
    spinning.plain("server").create_service(Trigger, "thing", lambda _request, _response: answer)
    server = Server(node, Trigger, "thing")
    until(server.ready)
    server.ask(Trigger.Request(), lambda *one: said.append(one))
    until(lambda: said)
    assert (said[0][0].success, said[0][1]) == (True, "")
    assert server.call(Trigger.Request(), 10.0).success


def test_nobody_answers(spinning: Any) -> None:
    """As where a server was killed: the graph shows it for 20 s more."""
    said, now = Said(), time.monotonic()
    for kind in (Trigger, Measure):
        server = Server(spinning.plain(), kind, "nobody")
        assert server.missing().endswith("nobody")
        request = Trigger.Request() if kind is Trigger else Measure.Goal()
        server.ask(request, lambda *one: said.append(one), 3.0, accept=3.0)
        server.tick(now)
        server.tick(now + 4.0)
        server.tick(now + 5.0)
        assert server.call(Trigger.Request(), 0.01) is None
    assert said == [(None, "nobody does not answer")] * 2


def test_what_is_not_wanted_any_more_is_cancelled_once_it_is_accepted(spinning: Any, until: Any) -> None:
    said, cancelled, begun = Said(), list[bool](), list[bool]()
    node = spinning.plain("server")

    def accept(_goal: Any) -> GoalResponse:
        begun.append(True)
        time.sleep(0.3)
        return GoalResponse.ACCEPT

    def run(goal: Any) -> Any:
        cancelled.append(goal.is_cancel_requested)
        goal.succeed()
        return Measure.Result()

    action = ActionServer(
        node, Measure, "measure", run, goal_callback=accept, handle_accepted_callback=lambda _goal: None,
        cancel_callback=lambda _goal: cancelled.append(True),
    )  # fmt: skip
    server = Server(spinning.plain("asker"), Measure, "measure")
    until(server.ready)
    one = server.ask(Measure.Goal(), lambda *one: said.append(one))
    until(lambda: begun)
    assert one.goal is None
    server.drop()
    assert (said, one.over) == ([(None, "it is not wanted any more")], True)
    until(lambda: cancelled)
    action.destroy()
