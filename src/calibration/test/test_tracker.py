"""The node `tracker`: what goes in comes out in metres, checked and averaged."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.action import Measure
from calibration_interfaces.msg import Outcome, SampleCheck, SessionEvent
from geometry_msgs.msg import (
    PointStamped,
    PoseStamped,
    PoseWithCovarianceStamped,
    TransformStamped,
)
from goals import GoalClient
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from stand_ins import CELL, IRREGULAR, Feed, finish, measure, overrides

from calibration.conversions import stamp_ns, to_header, transforms
from calibration.instruments.tracker import TrackerNode
from calibration.node import ParameterError
from calibration.topics import EVENT
from calibration_core.cell import load_cell
from calibration_core.errors import InputError
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import NANOSECONDS

HERE = np.array([1.25, -2.5, 0.75])


def incoming(kind: str, values: np.ndarray, time_ns: int) -> Any:
    header = to_header(time_ns, "lasertracker")
    x, y, z = (float(one) for one in values)
    if kind == "PointStamped":
        message = PointStamped(header=header)
        message.point.x, message.point.y, message.point.z = x, y, z
        return message
    if kind == "TransformStamped":
        message = TransformStamped(header=header, child_frame_id="smr_1")
        moved = message.transform.translation
    elif kind == "PoseStamped":
        message = PoseStamped(header=header)
        moved = message.pose.position
    else:
        message = PoseWithCovarianceStamped(header=header)
        moved = message.pose.pose.position
    moved.x, moved.y, moved.z = x, y, z
    return message


CLASSES = {
    "PointStamped": PointStamped,
    "PoseStamped": PoseStamped,
    "PoseWithCovarianceStamped": PoseWithCovarianceStamped,
    "TransformStamped": TransformStamped,
}


@pytest.mark.parametrize("kind", [*CLASSES, "tf"])
@pytest.mark.parametrize("reliability", [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE])
def test_every_kind_of_point_comes_out_in_metres(
    spinning: Any, feeds: list[Feed], until: Callable[..., None], kind: str, reliability: ReliabilityPolicy
) -> None:
    if kind == "tf":
        sent = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed").TFMessage
    else:
        sent = CLASSES[kind]
    topics = ["smr_1"] if kind == "tf" else ["leica/point"]
    node = spinning.add(
        TrackerNode(context=spinning.context, parameter_overrides=overrides(
            points=["mp2"], topics=topics, input_type=kind, units="mm", output_frame="tracker"))
    )  # fmt: skip
    client = spinning.plain()
    heard: list[PointStamped] = []
    client.create_subscription(PointStamped, "/tracker/mp2", heard.append, 100)
    qos = QoSProfile(depth=10, reliability=reliability)
    start = node.now_ns()

    def make(k: int) -> Any:
        one = incoming("TransformStamped" if kind == "tf" else kind, 1e3 * HERE + 1e-3 * k, start + k * 5_000_000)
        return sent(transforms=[one]) if kind == "tf" else one

    publisher = client.create_publisher(sent, "/tf" if kind == "tf" else topics[0], qos)
    feeds.append(Feed(publisher, make))
    until(lambda: len(heard) >= 5)
    first = heard[0]
    k = round((stamp_ns(first.header.stamp) - start) / 5_000_000)
    np.testing.assert_allclose([first.point.x, first.point.y, first.point.z], HERE + 1e-6 * k, rtol=1e-12)
    assert first.header.frame_id == "tracker"


def test_a_package_that_is_missing_is_named(context: Any) -> None:
    if importlib.util.find_spec("tf2_msgs"):
        pytest.skip("tf2_msgs is installed here")
    with pytest.raises(InputError, match="found no package tf2_msgs, expected the package ros-jazzy-tf2-msgs"):
        TrackerNode(context=context, parameter_overrides=overrides(input_type="tf"))


def test_transforms_are_told_apart_by_their_child_frame() -> None:
    message = SimpleNamespace(transforms=[incoming("TransformStamped", 1e3 * HERE, 5)])
    message.transforms.append(TransformStamped(child_frame_id="tool0"))
    found = transforms(message, {"smr_1": "mp2"}, 1e-3)
    assert list(found) == ["mp2"]
    np.testing.assert_allclose(found["mp2"].values, HERE)
    assert (found["mp2"].stamp, found["mp2"].frame) == (5, "lasertracker")


def test_measure_averages_every_point(spinning: Any, feeds: list[Feed], until: Callable[..., None]) -> None:
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=overrides()))
    client = spinning.plain()
    rng = np.random.default_rng(1)
    for name, shift in (("mp1", 0.0), ("mp2", 1.0), ("mp3", 2.0)):
        publisher = client.create_publisher(PointStamped, f"input/{name}", 100)

        def make(_k: int, shift: float = shift) -> Any:
            return incoming("PointStamped", HERE + shift + 1e-5 * rng.standard_normal(3), node.now_ns())

        feeds.append(Feed(publisher, make, 0.004))
    result = measure(client, "/tracker/measure", Measure.Goal())
    assert result.outcome.code == Outcome.OK, result.outcome.text
    assert [one.name for one in result.averages] == ["mp1", "mp2", "mp3"]
    for one, shift in zip(result.averages, (0.0, 1.0, 2.0), strict=True):
        np.testing.assert_allclose(one.mean, HERE + shift, atol=2e-5)
        assert one.samples >= 10
        assert 0 < np.sqrt(one.covariance[0]) < 1e-5
        assert stamp_ns(one.end) - stamp_ns(one.begin) >= 200_000_000
    result = measure(client, "/tracker/measure", Measure.Goal(names=["mp3"], window=0.1))
    assert [one.name for one in result.averages] == ["mp3"]


def test_measure_says_why_it_cannot(spinning: Any, feeds: list[Feed]) -> None:
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=overrides(frozen=5, timeout=0.6)))
    client = spinning.plain()
    result = measure(client, "/tracker/measure", Measure.Goal(names=["mp9"]))
    assert result.outcome.code == Outcome.INPUT_UNUSABLE
    assert "expected one of mp1, mp2, mp3" in result.outcome.text
    result = measure(client, "/tracker/measure", Measure.Goal(window=-1.0))
    assert result.outcome.code == Outcome.INPUT_UNUSABLE
    result = measure(client, "/tracker/measure", Measure.Goal(names=["mp1"]))
    assert result.outcome.code == Outcome.NO_DATA
    publisher = client.create_publisher(PointStamped, "input/mp1", 100)
    feeds.append(Feed(publisher, lambda k: incoming("PointStamped", HERE + 1e-4 * k, node.now_ns())))
    result = measure(client, "/tracker/measure", Measure.Goal(names=["mp1"], timeout=6.0))
    assert result.outcome.code == Outcome.NOT_SETTLED, result.outcome.text
    feeds.pop().stop()
    feeds.append(Feed(publisher, lambda _k: incoming("PointStamped", HERE, node.now_ns())))
    result = measure(client, "/tracker/measure", Measure.Goal(names=["mp1"], timeout=3.0))
    assert result.outcome.code == Outcome.TIMED_OUT
    assert "frozen" in result.outcome.text


def test_measure_can_be_cancelled(spinning: Any) -> None:
    spinning.add(TrackerNode(context=spinning.context, parameter_overrides=overrides(timeout=60.0)))
    client = GoalClient(spinning.plain(), Measure, "/tracker/measure")
    assert client.wait_for_server(15.0)
    handle = finish(client.send_goal_async(Measure.Goal()))
    assert finish(handle.cancel_goal_async()).goals_canceling
    assert finish(handle.get_result_async()).result.outcome.code == Outcome.CANCELLED


def test_the_health_of_a_stream_is_told(spinning: Any, feeds: list[Feed], until: Callable[..., None]) -> None:
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=overrides(frame="lasertracker")))
    client = spinning.plain()
    heard: list[SampleCheck] = []
    passed: list[PointStamped] = []
    client.create_subscription(SampleCheck, "/calibration/sample_check", heard.append, 100)
    client.create_subscription(PointStamped, "/tracker/mp1", passed.append, 100)
    until(lambda: any(one.problem == SampleCheck.SILENT and one.name == "mp1" for one in heard))
    publisher = client.create_publisher(PointStamped, "input/mp1", 100)
    rng = np.random.default_rng(2)

    def make(k: int) -> Any:
        wild = {20: np.full(3, np.nan), 40: HERE + 1.0}.get(k, HERE + 1e-5 * rng.standard_normal(3))
        message = incoming("PointStamped", wild, node.now_ns())
        message.header.frame_id = "base" if k == 60 else "lasertracker"
        return message

    feeds.append(Feed(publisher, make))
    until(lambda: any(one.not_finite and one.jumps and one.wrong_frame for one in heard))
    until(lambda: heard[-1].problem == SampleCheck.FINE or heard[-1].name != "mp1", timeout=5.0)
    last = [one for one in heard if one.name == "mp1"][-1]
    assert (last.not_finite, last.jumps, last.wrong_frame) == (1, 1, 1)
    assert last.accepted == last.received - 3
    assert np.isfinite([[one.point.x, one.point.y] for one in passed]).all()


@pytest.mark.parametrize("topic", ["input/mp1", "tracker/mp1"])
def test_of_two_that_publish_a_point_none_is_read(
    spinning: Any, feeds: list[Feed], until: Callable[..., None], topic: str
) -> None:
    given = overrides(gap=IRREGULAR)
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=given))
    first, second, client = (spinning.plain(name) for name in ("driver", "old_driver", "reader"))
    heard: list[SampleCheck] = []
    client.create_subscription(SampleCheck, "/calibration/sample_check", heard.append, 100)
    rng = np.random.default_rng(3)
    make = lambda _: incoming("PointStamped", HERE + 1e-5 * rng.standard_normal(3), node.now_ns())  # noqa: E731
    feeds.append(Feed(first.create_publisher(PointStamped, "input/mp1", 100), make))
    until(lambda: any(one.name == "mp1" and one.problem == SampleCheck.FINE for one in heard))
    rival = second.create_publisher(PointStamped, topic, 100)
    until(lambda: any(one.name == "mp1" and one.problem == SampleCheck.TWO_SOURCES for one in heard))
    words = next(str(one.text) for one in heard if one.problem == SampleCheck.TWO_SOURCES)
    own = "/driver" if topic.startswith("input") else "/tracker"
    assert words == f"/{topic} is published by {', '.join(sorted([own, '/old_driver']))}"
    result = measure(client, "/tracker/measure", Measure.Goal(names=["mp1"]))
    assert (result.outcome.code, result.outcome.text) == (Outcome.NOT_AVAILABLE, f"mp1: {words}")
    second.destroy_publisher(rival)
    until(lambda: [one for one in heard if one.name == "mp1"][-1].problem == SampleCheck.FINE)
    assert measure(client, "/tracker/measure", Measure.Goal(names=["mp1"])).outcome.code == Outcome.OK


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"points": ["mp9"]}, "points: found 'mp9'"),
        ({"points": ["mp1", "mp1"]}, "points: found a point twice"),
        ({"topics": ["a"]}, "topics: found 1 topics, expected 3"),
        (
            {"stamp": "sender_offset", "driver": "manual"},
            "stamp: found 'sender_offset', expected that with driver stream",
        ),
        ({"stamp": "sender_offset", "points": ["mp1"], "topics": ["tracker/mp1"]}, "topics: found 'tracker/mp1'"),
        ({"units": "km"}, "units: found 'km', expected one of m, mm, inch"),
    ],
)
def test_tracker_refuses_parameters_without_sense(context: Any, values: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        TrackerNode(context=context, parameter_overrides=overrides(**values))


def test_the_contracts_own_topic_is_only_checked(spinning: Any) -> None:
    node = spinning.add(
        TrackerNode(context=spinning.context, parameter_overrides=overrides(points=["mp1"], topics=["tracker/mp1"]))
    )
    assert [one.topic for one in node.publishers if "/tracker" in one.topic] == []


def test_samples_from_before_are_not_averaged_however_late_they_arrive(spinning: Any, feeds: list[Feed]) -> None:
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=overrides(points=["mp1"])))
    client = spinning.plain()
    start = node.now_ns()
    publisher = client.create_publisher(PointStamped, "input/mp1", 100)
    feeds.append(Feed(publisher, lambda k: incoming("PointStamped", HERE + 1e-9 * (k % 7), start + k * 5_000_000)))
    since = start + 3_000_000_000
    result = measure(client, "tracker/measure", Measure.Goal(names=["mp1"], since=to_header(since).stamp))
    assert result.outcome.code == Outcome.OK, result.outcome.text
    assert stamp_ns(result.averages[0].begin) >= since


class OwnClock:
    """A robot that moves on command, and a tracker whose clock is ahead and gains; times are ns of the node."""

    OFFSET, RATE, LENGTH = 5_600_000_000, 1.001, 3.0

    def __init__(self, node: Any, client: Any, feeds: list[Feed]) -> None:
        cell = load_cell(CELL)
        self._now, self._chain, self._point = node.now_ns, chain_of(cell), nominal_parameters(cell).points["mp1"]
        self._names, self._start, self._went = list(cell.robot.joints), node.now_ns(), [node.now_ns() + 10**18]
        self._rng = np.random.default_rng(1)
        self.shift = 0
        joints = client.create_publisher(JointState, "joint_states", 100)
        points = client.create_publisher(PointStamped, "input/mp1", 100)
        feeds.append(Feed(joints, self._joints, 0.008))
        feeds.append(Feed(points, self._seen, 0.01))

    def go(self) -> None:
        self._went.append(self._now())

    def _q(self, now: int) -> np.ndarray:
        q = np.zeros(6)
        for number, begin in enumerate(self._went):
            share = np.clip((now - begin) / NANOSECONDS / self.LENGTH, 0.0, 1.0)
            q[:2] += (10 * share**3 - 15 * share**4 + 6 * share**5) * np.array([0.3, 0.1]) * (1 if number % 2 else -1)
        return q

    def _joints(self, _k: int) -> JointState:
        now = self._now()
        return JointState(header=to_header(now), name=self._names, position=self._q(now).tolist())

    def _seen(self, _k: int) -> PointStamped:
        now = self._now()
        place = posture(self._chain, self._q(now)[None]).point(self._point)[:, 0] + 2e-5 * self._rng.standard_normal(3)
        return incoming("PointStamped", place, self.sender(now))

    def sender(self, now: int) -> int:
        return now + self.OFFSET + self.shift + round((self.RATE - 1.0) * (now - self._start))


def test_a_clock_of_its_own_is_learnt_from_motion(spinning: Any, feeds: list[Feed], until: Callable[..., None]) -> None:
    given = overrides(points=["mp1"], stamp="sender_offset", gap=IRREGULAR)
    node = spinning.add(TrackerNode(context=spinning.context, parameter_overrides=given))
    client = spinning.plain()
    heard: list[tuple[int, int]] = []
    checks: list[SampleCheck] = []
    events: list[SessionEvent] = []
    client.create_subscription(SessionEvent, "calibration/event", events.append, EVENT.qos)
    client.create_subscription(
        PointStamped, "tracker/mp1", lambda one: heard.append((stamp_ns(one.header.stamp), node.now_ns())), 1000
    )
    client.create_subscription(SampleCheck, "/calibration/sample_check", checks.append, 1000)
    world = OwnClock(node, client, feeds)
    until(lambda: checks and checks[-1].received > 50)
    assert checks[-1].text == "fine; the tracker's clock is not known (no motion was seen): move the robot"
    result = measure(client, "tracker/measure", Measure.Goal(timeout=0.5))
    assert result.outcome.code == Outcome.TIMED_OUT
    assert "move the robot (waited 0.5 s)" in result.outcome.text
    assert heard == []
    world.go()
    until(lambda: bool(heard), timeout=15.0)
    until(lambda: "ahead of the robot's, rate " in checks[-1].text, timeout=5.0)
    result = measure(client, "tracker/measure", Measure.Goal())
    assert result.outcome.code == Outcome.OK, result.outcome.text
    until(lambda: bool(events))
    assert [(one.kind, one.source) for one in events] == [(SessionEvent.TRACKER_CLOCK, "tracker")]
    assert events[0].text.startswith("the tracker's clock is 5.6")
    world.go()
    until(lambda: not node.joints.moving(), timeout=5.0)
    count = len(heard)
    until(lambda: len(heard) > count + 400, timeout=15.0)
    stamps, received = np.array(heard).T
    assert np.all(np.diff(stamps) > 0)
    assert np.abs(received - stamps).max() < NANOSECONDS
    assert np.median(received - stamps) < 0.02 * NANOSECONDS
    last = checks[-1]
    assert (last.out_of_order, last.jumps) == (0, 0)
    world.shift = 100 * NANOSECONDS  # the tracker was started again
    until(lambda: "(it was set): move the robot" in checks[-1].text, timeout=5.0)
    count = len(heard)
    assert measure(client, "tracker/measure", Measure.Goal(timeout=0.5)).outcome.code == Outcome.TIMED_OUT
    assert len(heard) - count < 20
    world.go()
    until(lambda: "the tracker's clock is 105.6" in checks[-1].text, timeout=15.0)
    assert measure(client, "tracker/measure", Measure.Goal()).outcome.code == Outcome.OK
    assert checks[-1].out_of_order == 0
