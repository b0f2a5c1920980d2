"""Messages to core values and back; the table of topics; work beside the executor."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces import msg
from geometry_msgs.msg import PointStamped, PoseStamped, WrenchStamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from calibration import conversions as to
from calibration.background import Background, in_executor
from calibration.topics import Quality, incompatible, message_class, offered_qos, profile, subscription_profile
from calibration_core.observations.average import average
from calibration_core.observations.samples import Problem
from calibration_core.timeseries import Phase

INTERFACES = Path(__file__).resolve().parents[2] / "calibration_interfaces"
finite = st.floats(allow_nan=False, allow_infinity=False)
vector = st.lists(finite, min_size=6, max_size=6).map(np.array)


@given(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_stamps_round_trip(time_ns: int) -> None:
    assert to.stamp_ns(to.to_stamp(time_ns)) == time_ns


@pytest.mark.parametrize("time_ns", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_a_stamp_beyond_ros(time_ns: int) -> None:
    with pytest.raises(ValueError, match="not a time of ROS"):
        to.to_stamp(time_ns)


@given(vector, st.integers(1, 2**31 * 10**9 - 1))
def test_samples_round_trip(values: np.ndarray, time_ns: int) -> None:
    wrench = to.to_wrench_stamped(to.Sample(time_ns, "ft", values))
    back = to.wrench_sample(wrench, 1.0, 1.0)
    np.testing.assert_array_equal(back.values, values)
    assert (back.stamp, back.frame) == (time_ns, "ft")
    point = to.to_point_stamped(to.Sample(time_ns, "t", values[:3]))
    back = to.POINT_INPUTS["PointStamped"][1](point, 1.0)
    np.testing.assert_array_equal(back.values, values[:3])


def test_averages_round_trip() -> None:
    for width in (3, 6):
        values = np.random.default_rng(width).standard_normal((50, width))
        mean = to.Mean("mp1", "tracker", 10**18, 10**18 + 10**9, average(values), tare=2)
        message = to.to_average(mean)
        back = to.from_average(message)
        np.testing.assert_array_equal(back.average.mean, mean.average.mean)
        np.testing.assert_array_equal(back.average.covariance, mean.average.covariance)
        assert (back.name, back.frame, back.begin, back.end, back.tare) == ("mp1", "tracker", 10**18, 10**18 + 10**9, 2)
        assert back.average.effective == mean.average.effective
        assert to.stamp_ns(message.header.stamp) == 10**18 + 5 * 10**8


def test_rotation_comes_along() -> None:
    message = PoseStamped()
    message.pose.orientation.w, message.pose.orientation.z = 0.6, 0.8
    sample = to.POINT_INPUTS["PoseStamped"][1](message, 1.0)
    assert sample.rotation is not None
    assert sample.rotation.tolist() == [0.0, 0.0, 0.8, 0.6]


def test_joints_are_taken_by_name() -> None:
    message = JointState(name=["c", "a", "b"], position=[3.0, 1.0, 2.0])
    found = to.joint_positions(message, ("a", "b", "c"))
    assert found is not None
    assert found.tolist() == [1.0, 2.0, 3.0]
    assert to.joint_positions(message, ("a", "d")) is None
    assert to.joint_positions(JointState(name=["a"], position=[]), ("a",)) is None


def test_step_markers() -> None:
    message = to.to_step(5, 3, 2, Phase.MEASURING)
    assert (message.configuration, message.step, message.phase) == (3, 2, msg.MeasurementStep.MEASURING)


def test_numbers_of_the_core_are_those_of_the_messages() -> None:
    assert {one.name: one.value for one in Problem} == {
        name: getattr(msg.SampleCheck, name) for name in dir(msg.SampleCheck) if name in Problem.__members__
    }
    assert {one.name: one.value for one in Phase} == {
        name: getattr(msg.MeasurementStep, name) for name in dir(msg.MeasurementStep) if name in Phase.__members__
    }


def test_every_field_of_the_interfaces_is_described() -> None:
    """Only headers and outcomes say all by their type."""
    silent = []
    for path in sorted(INTERFACES.glob("*/*.*")):
        if path.suffix not in {".msg", ".srv", ".action"}:
            continue
        for line in path.read_text("utf-8").splitlines():
            field = re.match(r"^[\w/\[\]<=]+ +(\w+)( *#.*)?$", line)
            if field and not field[2] and field[1] not in {"header", "outcome"}:
                silent.append(f"{path.name}: {line}")
    assert silent == []


# --- topics -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("quality", list(Quality))
def test_profiles(quality: Quality) -> None:
    found = profile(quality)
    assert found.reliability == ReliabilityPolicy.RELIABLE
    kept = found.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert kept is (quality in (Quality.STATE, Quality.EVENTS))
    assert found.depth >= {Quality.SAMPLES: 2000, Quality.EVENTS: 1000}.get(quality, 1)
    assert set(offered_qos(found)) >= {"history", "depth", "reliability", "durability", "deadline", "lifespan"}


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE])
@pytest.mark.parametrize("durability", [DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL])
def test_subscriptions_ask_for_what_is_offered(
    spinning: Any, until: Callable[..., None], reliability: ReliabilityPolicy, durability: DurabilityPolicy
) -> None:
    node = spinning.plain()
    assert subscription_profile(node, "points").reliability == ReliabilityPolicy.BEST_EFFORT
    offered = QoSProfile(depth=5, reliability=reliability, durability=durability)
    node.create_publisher(PointStamped, "points", offered)
    until(lambda: node.get_publishers_info_by_topic("points"))
    asked = subscription_profile(node, "points")
    assert (asked.reliability, asked.durability, asked.depth) == (reliability, durability, 2000)
    assert incompatible(node, "points", asked) == []
    strict = profile(Quality.STATE)
    possible = (reliability, durability) == (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
    assert (incompatible(node, "points", strict) == []) is possible


def test_message_classes() -> None:
    assert message_class("geometry_msgs/msg/WrenchStamped") is WrenchStamped
    with pytest.raises(ModuleNotFoundError):
        message_class("no_such_msgs/msg/Thing")


# --- work beside the executor -----------------------------------------------------------------------------------


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
    import rclpy

    node, where = rclpy.create_node("alone", context=context), list[str]()
    in_executor(node, lambda: where.append(threading.current_thread().name))
    assert where == [threading.current_thread().name]
    node.destroy_node()


def test_an_outcome_is_one_line() -> None:
    assert to.to_outcome(msg.Outcome.OK, "first\nsecond\n").text == "first; second"
