"""Samples that wait, as on a busy machine, are taken in few turns of the executor, all of them and in their order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from calibration.topics import IN_A_TURN, SAMPLES_DEPTH, subscribe_to_samples

SENT = 3 * IN_A_TURN


def spun(context: Any, node: Any, turns: int) -> None:
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    for _ in range(turns):
        executor.spin_once(timeout_sec=0.2)
    executor.shutdown()


@pytest.fixture
def waiting(context: Any, until: Any) -> Any:
    """A node, and a function that sends it samples while nothing spins it."""
    import rclpy

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


def test_what_waits_is_taken_in_few_turns(context: Any, waiting: Any) -> None:
    node, send = waiting
    taken: list[float] = []
    quality = QoSProfile(depth=SAMPLES_DEPTH)
    subscribe_to_samples(node, JointState, "joint_states", lambda one: taken.append(one.position[0]), quality)
    send(SENT)
    spun(context, node, turns=6)  # half of them may be of the node's own services
    assert taken == [float(one) for one in range(SENT)]


def test_a_turn_ends_however_much_waits(context: Any, waiting: Any) -> None:
    node, send = waiting
    taken: list[float] = []
    quality = QoSProfile(depth=SAMPLES_DEPTH)
    subscription = subscribe_to_samples(
        node, JointState, "joint_states", lambda one: taken.append(one.position[0]), quality
    )
    send(SENT)
    with subscription.handle:
        first = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    subscription.callback(*first)
    assert len(taken) == IN_A_TURN


def test_a_subscription_that_its_callback_destroys(context: Any, waiting: Any) -> None:
    node, send = waiting
    taken: list[float] = []

    def take(one: JointState) -> None:
        taken.append(one.position[0])
        node.destroy_subscription(subscription)

    subscription = subscribe_to_samples(node, JointState, "joint_states", take, QoSProfile(depth=SAMPLES_DEPTH))
    send(SENT)
    spun(context, node, turns=3)
    assert taken == [0.0]
    assert list(node.subscriptions) == []


@pytest.mark.parametrize("every", [0.0, 0.1])
def test_a_sample_may_come_before_the_subscription_is_there(every: float) -> None:
    """The executor is another thread: it may take a sample, or look for some, while the node still subscribes."""
    taken: list[str] = []

    class Quick:
        def create_timer(self, _period: float, look: Callable[[], None], **_more: Any) -> None:
            look()

        def create_subscription(self, _kind: Any, _name: str, take: Any, _quality: Any, **_more: Any) -> str:
            take("first", {})
            return "made"

    quality = QoSProfile(depth=1)
    assert subscribe_to_samples(Quick(), JointState, "joint_states", taken.append, quality, every=every) == "made"  # type: ignore[arg-type]
    assert taken == ["first"]
