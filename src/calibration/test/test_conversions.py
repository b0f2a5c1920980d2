"""Messages to core values and back; the table of topics; work beside the executor."""

from __future__ import annotations

import math
import re
import struct
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
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from calibration import conversions as to
from calibration.topics import Quality, incompatible, message_class, offered_qos, profile, subscription_profile
from calibration_core.observations.average import average
from calibration_core.observations.samples import Problem
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.layout import Mould, layout_of
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
    back = to.wrench_sample(wrench)
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


def test_an_outcome_is_one_line() -> None:
    assert to.to_outcome(msg.Outcome.OK, "first\nsecond\n").text == "first; second"


def test_joint_states_are_read_as_they_are_sent() -> None:
    """Frames, orders and other devices by turns, as a driver and a gripper send them on one topic."""
    from rclpy.serialization import serialize_message

    reader = to.JointReader(("a", "b"))
    turned = JointState(name=["b", "x", "a"], position=[2.0, 9.0, 1.0], velocity=[0.0] * 3)
    turned.header = to.to_header(1_000_000_007, "base")
    for message in (
        JointState(header=to.to_header(5), name=["a", "b"], position=[0.1, 0.2]),
        turned,
        JointState(name=["gripper"], position=[0.5]),
        JointState(name=["a", "b"], position=[0.1]),
        JointState(header=to.to_header(6), name=["a", "b"], position=[math.nan, 0.3], effort=[1.0, 2.0]),
        JointState(header=to.to_header(7), name=["a", "b"], position=[0.2, 0.4], effort=[1.0, 2.0]),
    ):
        read, q = reader.read(serialize_message(message)), to.joint_positions(message, ("a", "b"))
        assert reader.names == tuple(message.name[: len(message.position)])
        assert (read is None) == (q is None)
        if read is not None:
            assert read[0] == to.stamp_ns(message.header.stamp)
            np.testing.assert_array_equal(read[1], q)


@given(vector, st.integers(1, 2**31 * 10**9 - 1), st.sampled_from(["", "ft", "sensor"]))
def test_wrenches_are_read_and_cast_as_they_are_sent(values: np.ndarray, time_ns: int, frame: str) -> None:
    from rclpy.serialization import serialize_message

    payload = serialize_message(to.to_wrench_stamped(to.Sample(time_ns, frame, values)))
    read = to.WrenchReader().read(payload)
    np.testing.assert_array_equal(read.values, values)
    assert (read.stamp, read.frame) == (time_ns, frame)
    first = serialize_message(to.to_wrench_stamped(to.Sample(7, frame, np.ones(6))))
    assert Mould(StreamKind.WRENCH, first).cast(time_ns, values.tolist()) == payload
    with pytest.raises(ValueError, match="no little-endian"):
        Mould(StreamKind.WRENCH, payload[:-1])


@pytest.mark.parametrize("count", range(1, 9))
def test_joint_states_are_cast_without_what_means_nothing(count: int) -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    names, q = [f"joint_{i}" for i in range(count)], [0.5 * i for i in range(count)]
    mould = Mould(StreamKind.JOINTS, serialize_message(JointState(name=names, position=[0.0] * count)))
    payload = mould.cast(1_000_000_007, q)
    assert deserialize_message(payload, JointState) == JointState(
        header=to.to_header(1_000_000_007), name=names, position=q
    )
    assert layout_of(StreamKind.JOINTS, payload) is not None  # the quick way is open


def test_joint_states_of_another_byte_order() -> None:
    order = ">iI I2s2x I I2s2x I2s2x I dd I I"
    stamp, joints = (3, 4, 2, b"f\0"), (2, 2, b"a\0", 2, b"b\0")
    body = struct.pack(order.replace(" ", ""), *stamp, *joints, 2, 0.5, 0.25, 0, 0)
    stamp_read, q = to.JointReader(("b", "a")).read(b"\0\0\0\0" + body) or (0, np.zeros(0))
    assert (stamp_read, q.tolist()) == (3_000_000_004, [0.25, 0.5])
