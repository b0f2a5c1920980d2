"""What the suite uses of the inside of rclpy is there; samples that wait are all taken, and in their order."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

import rclpy
from calibration_interfaces.action import Measure
from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from calibration.rclpy_gaps import IN_A_TURN, Background, RCLError, Waiting, given_parameters, hidden, in_executor
from calibration.topics import SAMPLES_DEPTH

SENT = 3 * IN_A_TURN


@pytest.fixture
def waiting(context: Any, until: Any) -> Any:
    """A node, and a function that sends it samples while nothing spins it."""
    node = rclpy.create_node("listener", context=context)
    sender = rclpy.create_node("sender", context=context)
    publisher = sender.create_publisher(JointState, "joint_states", QoSProfile(depth=SAMPLES_DEPTH))

    def send(number: int) -> None:
        until(lambda: publisher.get_subscription_count() == 1)
        for one in range(number):
            publisher.publish(JointState(position=[float(one)]))
        assert publisher.wait_for_all_acked()

    yield node, send
    node.destroy_node()
    sender.destroy_node()


@pytest.mark.parametrize("raw", [False, True])
def test_what_waits_wakes_nobody(context: Any, waiting: Any, raw: bool) -> None:
    node, send = waiting
    kept = Waiting(node, JointState, "joint_states", QoSProfile(depth=SAMPLES_DEPTH), raw=raw)
    send(SENT)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    with contextlib.suppress(TimeoutException):
        while True:
            _handler, entity, _node = executor.wait_for_ready_callbacks(timeout_sec=0.2)
            assert entity not in node.subscriptions
    executor.shutdown()
    assert len(kept.take()) == IN_A_TURN
    rest = kept.take(SENT)
    assert (len(rest), kept.take()) == (SENT - IN_A_TURN, [])
    last = deserialize_message(rest[-1], JointState) if raw else rest[-1]
    assert last.position[0] == SENT - 1.0


def test_what_waits_is_as_old_as_it_is(waiting: Any) -> None:
    """Whoever looks late, as on a busy machine, knows when it arrived, and what number it had."""
    node, send = waiting
    kept = Waiting(node, JointState, "joint_states", QoSProfile(depth=SAMPLES_DEPTH))
    began = time.monotonic()
    send(2)
    sent = time.monotonic()
    time.sleep(0.3)  # nobody looks
    found = [(one.position[0], arrived, number) for one, arrived, number in kept.arrivals()]
    assert [(value, number) for value, _, number in found] == [(0.0, 1), (1.0, 2)]
    assert began <= found[0][1] <= found[1][1] <= sent
    send(1)
    ((_, arrived, number),) = kept.arrivals()
    assert sent + 0.3 <= arrived <= time.monotonic()
    assert number == 3


def test_a_clock_that_was_set_makes_nothing_older_than_the_last_look(
    waiting: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, send = waiting
    kept = Waiting(node, JointState, "joint_states", QoSProfile(depth=SAMPLES_DEPTH))
    real = time.time
    for shift in (3600.0, -3600.0):
        assert list(kept.arrivals()) == []
        looked = time.monotonic()
        send(1)
        monkeypatch.setattr(time, "time", lambda shift=shift: real() + shift)
        ((_, arrived, _),) = kept.arrivals()
        monkeypatch.setattr(time, "time", real)
        assert looked - 0.01 <= arrived <= time.monotonic()


def test_a_subscription_that_waits_and_is_destroyed(waiting: Any) -> None:
    node, _send = waiting
    kept = Waiting(node, JointState, "joint_states", QoSProfile(depth=1))
    node.destroy_subscription(next(iter(node.subscriptions)))
    assert kept.take() == []


def test_the_hidden_topics_and_services_of_an_action(context: Any) -> None:
    node = rclpy.create_node("server", context=context)
    server = ActionServer(node, Measure, "measure", lambda _goal: Measure.Result())
    topics = dict(node.get_publisher_names_and_types_by_node("server", "/"))
    services = dict(node.get_service_names_and_types_by_node("server", "/"))
    assert {f"/{hidden('measure', one)}" for one in ("status", "feedback")} <= set(topics)
    assert {f"/{hidden('measure', one)}" for one in ("send_goal", "cancel_goal")} <= set(services)
    server.destroy()
    node.destroy_node()


def test_parameters_that_nobody_declares_are_there(context: Any) -> None:
    node = rclpy.create_node("one", context=context, parameter_overrides=[Parameter("misspelt", value=3)])
    assert given_parameters(node)["misspelt"].value == 3
    node.destroy_node()


def test_what_a_context_raises_that_has_ended() -> None:
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node("late", context=context)
    publisher = node.create_publisher(JointState, "joint_states", 1)
    context.shutdown()
    with pytest.raises(RCLError):
        publisher.publish(JointState())


def test_waiting_does_not_hold_the_executor(spinning: Any) -> None:
    node = spinning.plain("server")
    released, group = threading.Event(), ReentrantCallbackGroup()

    async def slow(_request: Any, response: Any) -> Any:
        response.success = await Background(node, lambda: released.wait(10.0))
        return response

    def quick(_request: Any, response: Any) -> Any:
        response.message = "here"
        return response

    node.create_service(Trigger, "slow", slow, callback_group=group)
    node.create_service(Trigger, "quick", quick)
    client = spinning.plain("client")
    waiting, other = client.create_client(Trigger, "slow"), client.create_client(Trigger, "quick")
    assert waiting.wait_for_service(15.0)
    assert other.wait_for_service(15.0)
    future = waiting.call_async(Trigger.Request())
    assert other.call(Trigger.Request()).message == "here"
    assert not future.done()
    released.set()
    end = time.monotonic() + 10.0
    while not future.done() and time.monotonic() < end:
        time.sleep(0.005)
    assert future.result().success


def test_errors_are_raised_where_the_result_is_awaited(spinning: Any) -> None:
    node = spinning.plain("server")

    def fail() -> bool:
        message = "deliberate"
        raise KeyError(message)

    async def answer(_request: Any, response: Any) -> Any:
        try:
            await Background(node, fail)
        except KeyError as error:
            response.message = str(error)
        return response

    node.create_service(Trigger, "failing", answer, callback_group=ReentrantCallbackGroup())
    client = spinning.plain("client").create_client(Trigger, "failing")
    assert client.wait_for_service(15.0)
    assert client.call(Trigger.Request()).message == "'deliberate'"


def test_what_is_short_is_done_by_the_thread_that_spins(spinning: Any, until: Any) -> None:
    node, where = spinning.plain("short"), list[str]()
    in_executor(node, lambda: where.append(threading.current_thread().name))
    until(lambda: where)
    assert where != [threading.current_thread().name]


def test_where_nobody_spins_it_is_done_at_once(context: Any) -> None:
    node, where = rclpy.create_node("alone", context=context), list[str]()
    in_executor(node, lambda: where.append(threading.current_thread().name))
    assert where == [threading.current_thread().name]
    node.destroy_node()
