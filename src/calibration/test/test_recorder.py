"""The node `recorder`: everything of the table goes into the bag, nothing is lost, and the bag can always be read."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from granted import Granted

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.msg import MeasurementStep, Reading, RobotState, SessionEvent, TareEvent
from geometry_msgs.msg import PointStamped, WrenchStamped
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String
from std_srvs.srv import Trigger

from calibration import recorder as module
from calibration.cell.equipment import Recorder, Wanted
from calibration.conversions import to_header, to_step, to_wrench
from calibration.recorder import RecorderNode, definition
from calibration.topics import EVENT, OWN, READING, RECORDING, contract_topics, recorded_topics
from calibration_core.cell import load_cell
from calibration_core.errors import RecordingError
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.timeseries import Note, Phase

ROOT = Path(__file__).resolve().parents[3]
CELL_FILE = ROOT / "config" / "cells" / "demo.cell.yaml"
CELL = load_cell(CELL_FILE)
START = 1_700_000_000_000_000_000
MS = 1_000_000


def recorder(context: Any, out: Path | str, **values: Any) -> RecorderNode:
    given = {"cell": str(CELL_FILE), "out": str(out), **values}
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    return RecorderNode(context=context, parameter_overrides=overrides)


def listening(client: Any) -> Recorder:
    """Return the sequencer's view of the recorder, which hears it on the tick of a node."""
    user = Recorder(client, "recorder", 1.0)
    client.create_timer(0.02, user.take)
    return user


def matched(spinning: Any, until: Callable[..., None], tmp_path: Path, depth: int = 100) -> tuple[Any, Any, Any]:
    """Return a recorder, a node beside it, and that one's publisher of joint states, which the recorder has found."""
    node = spinning.add(recorder(spinning.context, tmp_path / "bag"))
    client = spinning.plain()
    publisher = client.create_publisher(JointState, "joint_states", depth)
    until(publisher.get_subscription_count)
    return node, client, publisher


def q(k: int) -> list[float]:
    return [0.001 * k + joint for joint in range(6)]


def joint_state(k: int) -> JointState:
    return JointState(header=to_header(START + k * MS), name=list(CELL.robot.joints), position=q(k))


def point(k: int) -> PointStamped:
    message = PointStamped(header=to_header(START + k * MS, "tracker"))
    message.point.x = float(k)
    return message


def test_the_recorders_list_is_what_the_reader_reads() -> None:
    topics = {topic.name: topic.type for topic in contract_topics(CELL)}
    names = CELL.topics
    read = {
        names.joint_states: StreamKind.JOINTS.value,
        names.wrench: StreamKind.WRENCH.value,
        names.temperature: StreamKind.TEMPERATURE.value,
        **{names.point(name): StreamKind.POINT.value for name in CELL.points},
        names.robot_description: "std_msgs/msg/String",
        names.step: "calibration_interfaces/msg/MeasurementStep",
        names.conditions: "calibration_interfaces/msg/Conditions",
    }
    assert topics == read
    recorded = [topic.name for topic in recorded_topics(CELL)]
    assert len(recorded) == len(set(recorded)) == len(read) + len(OWN)


@pytest.mark.parametrize("topic", recorded_topics(CELL), ids=lambda topic: topic.name)
def test_definitions_describe_the_messages(topic: Any) -> None:
    """The text alone has to tell other programs how to read what rclpy has written."""
    from rclpy.serialization import serialize_message

    text = definition(topic.type)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, topic.type))
    message = topic.message()
    for field, kind in message.get_fields_and_field_types().items():
        if kind == "sequence<double>":
            setattr(message, field, [1.0, 2.0])
    back = store.deserialize_cdr(serialize_message(message), topic.type)
    for field in message.get_fields_and_field_types():
        value = getattr(back, field)
        assert not isinstance(value, np.ndarray) or value.size in (2, 0, 9, 36)


def test_definition_of_what_is_not_installed() -> None:
    assert definition("no_such_msgs/msg/Thing") == ""


def test_everything_goes_into_the_bag(spinning: Any, until: Callable[..., None], tmp_path: Path) -> None:
    client = spinning.plain()
    best_effort = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    publishers = {
        "joint_states": client.create_publisher(JointState, "joint_states", 100),
        **{name: client.create_publisher(PointStamped, f"tracker/{name}", best_effort) for name in CELL.points},
        "wrench": client.create_publisher(WrenchStamped, "force_torque/wrench", 100),
        "temperature": client.create_publisher(Temperature, "cell/temperature", 10),
    }
    by_name = {topic.name: topic for topic in recorded_topics(CELL)}
    step = client.create_publisher(MeasurementStep, "calibration/step", by_name["/calibration/step"].qos)
    tare = client.create_publisher(TareEvent, "calibration/tare", by_name["/calibration/tare"].qos)
    urdf = client.create_publisher(String, "robot_description", by_name["/robot_description"].qos)
    urdf.publish(String(data="<robot/>"))  # before the recorder is there
    for k, phase in enumerate((Phase.MOVING, Phase.MEASURING)):
        step.publish(to_step(START + k * MS, 1, k, phase))
    node = spinning.add(recorder(spinning.context, tmp_path / "bag"))
    until(lambda: all(one.get_subscription_count() for one in publishers.values()))
    volatile = client.create_publisher(RobotState, "calibration/robot_state", 10)  # the recorder has to ask for less
    tare.publish(TareEvent(number=1))
    for k in range(200):
        publishers["joint_states"].publish(joint_state(k))
        for name in CELL.points:
            publishers[name].publish(point(k))
        volatile.publish(RobotState(source="test"))
        publishers["wrench"].publish(WrenchStamped(header=to_header(START + k * MS), wrench=to_wrench(np.full(6, k))))
        time.sleep(0.001)
    until(lambda: "/calibration/robot_state" in node._numbers)
    publishers["temperature"].publish(Temperature(header=to_header(START), temperature=21.5))
    service = client.create_client(Trigger, "recorder/close")
    until(lambda: node._bag is None or node._bag.messages > 5 * 200 + 5)
    answer = service.call(Trigger.Request())
    assert answer.success, answer.message
    back = read_bag(tmp_path / "bag", CELL)
    np.testing.assert_array_equal(back.joints.values, [q(k) for k in range(200)])
    for name in CELL.points:
        np.testing.assert_array_equal(back.points[name].values[:, 0], np.arange(200.0))
    assert back.wrench is not None
    np.testing.assert_array_equal(back.wrench.values[:, 5], np.arange(200.0))
    assert back.temperature is not None
    assert back.steps is not None
    assert back.steps.phase.tolist() == [Phase.MOVING, Phase.MEASURING]
    assert back.robot_description == "<robot/>"
    assert back.notes == ()
    with AnyReader([tmp_path / "bag"]) as reader:
        found = {connection.topic: connection for connection in reader.connections}
        tares = [
            reader.deserialize(raw, c.msgtype).number for c, _, raw in reader.messages() if c.topic.endswith("tare")
        ]
    assert tares == [1]
    assert all(str(connection.digest).startswith("RIHS01_") for connection in found.values())
    assert "/calibration/robot_state" in found


def test_close_and_open(spinning: Any, until: Callable[..., None], tmp_path: Path) -> None:
    node, client, publisher = matched(spinning, until, tmp_path)
    close, opening, hears = (client.create_client(Trigger, f"recorder/{what}") for what in ("close", "open", "hears"))
    assert close.wait_for_service(15.0)
    publisher.publish(joint_state(0))
    until(lambda: node._bag.messages)
    assert not opening.call(Trigger.Request()).success
    assert close.call(Trigger.Request()).message == f"1 messages in {tmp_path / 'bag' / 'bag_0.mcap'}"
    assert not close.call(Trigger.Request()).success
    publisher.publish(joint_state(1))
    assert publisher.wait_for_all_acked(Duration(seconds=20))
    assert hears.call(Trigger.Request()) is not None  # what came before it is taken by then ...
    taken = time.monotonic()
    until(lambda: node._written > taken)  # ... and left out
    assert opening.call(Trigger.Request()).success
    publisher.publish(joint_state(2))
    until(lambda: node._bag.messages)
    assert close.call(Trigger.Request()).success
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 2


def test_an_instrument_that_publishes_and_is_not_heard_is_named(
    spinning: Any, until: Callable[..., None], tmp_path: Path
) -> None:
    """It need not have sent anything: a tracker with one beam sends nothing before it is aimed."""
    node = spinning.add(recorder(spinning.context, tmp_path / "bag"))
    for timer in node.timers:
        timer.cancel()
    client = spinning.plain()
    hears = client.create_client(Trigger, "recorder/hears")
    assert hears.wait_for_service(15.0)
    assert hears.call(Trigger.Request()).success, "nobody publishes anything"
    publisher = client.create_publisher(JointState, "joint_states", 100)
    until(lambda: node.count_publishers("joint_states"))
    answer = hears.call(Trigger.Request())
    assert not answer.success
    assert answer.message == "nothing is heard yet of /joint_states"
    node._look()
    until(lambda: hears.call(Trigger.Request()).success)
    until(publisher.get_subscription_count)
    publisher.publish(joint_state(0))
    until(lambda: node._drain() or node._bag.messages)


def test_the_sequencer_waits_until_the_recorder_hears_and_has_its_bag(
    spinning: Any, until: Callable[..., None], tmp_path: Path
) -> None:
    node, client, publisher = matched(spinning, until, tmp_path)
    user = listening(client)
    client.create_publisher(PointStamped, "tracker/mp1", 100)
    until(lambda: node.count_publishers("tracker/mp1"))
    assert user.missing(10.0) == ""
    assert "/tracker/mp1" in node._heard
    wanted = Wanted(tmp_path / "session" / "bag", "a" * 64, 0)
    assert user.record(wanted) == ""
    assert node._bag.path == wanted.directory
    assert user.fault(time.monotonic()) == ""
    publisher.publish(joint_state(1))
    until(lambda: node._bag.messages)
    assert "found the bag of another plan" in user.record(Wanted(wanted.directory, "b" * 64, 0))
    assert user.record(wanted) == ""
    user.close()
    until(lambda: node._bag is None)
    assert user.recorded(tmp_path / "session", "bag") == (wanted.directory, "")
    none = Recorder(client, "", 1.0)  # without a recorder nothing is waited for
    assert (none.missing(0.1), none.record(wanted), none.fault(time.monotonic())) == ("", "", "")
    assert none.recorded(tmp_path, "bag") == (tmp_path, "")


def test_what_came_before_the_bag_was_closed_is_in_it(
    spinning: Any, until: Callable[..., None], tmp_path: Path
) -> None:
    """Also where the recorder lags behind."""
    node, client, publisher = matched(spinning, until, tmp_path, depth=1000)
    close = client.create_client(Trigger, "recorder/close")
    assert close.wait_for_service(15.0)
    publisher.publish(joint_state(0))
    until(lambda: node._bag.messages)
    for k in range(1, 500):
        publisher.publish(joint_state(k))
    assert close.call(Trigger.Request()).message == f"500 messages in {tmp_path / 'bag' / 'bag_0.mcap'}"


def test_what_came_before_the_recorder_ends_is_in_its_bag(
    spinning: Any, until: Callable[..., None], tmp_path: Path
) -> None:
    """Also what waits for its turn, as it does on a busy machine."""
    node, _, publisher = matched(spinning, until, tmp_path, depth=1000)
    publisher.publish(joint_state(0))
    until(lambda: node._bag.messages)
    busy = threading.Event()
    node.executor.create_task(busy.wait)
    for k in range(1, 500):
        publisher.publish(joint_state(k))
    assert publisher.wait_for_all_acked(Duration(seconds=20))
    ending = threading.Thread(target=node.stop)
    ending.start()
    time.sleep(0.3)
    busy.set()
    ending.join(20.0)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 500


def test_a_recorder_that_lost_its_disk_goes_on_by_itself(
    spinning: Any, until: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As soon as there is room again, in a further file; until then whoever measures is told why."""
    monkeypatch.setattr(module, "AGAIN", 0.2)
    node, client, publisher = matched(spinning, until, tmp_path)
    user = listening(client)
    wanted = Wanted(tmp_path / "session" / "bag", "a" * 64, 0, "s@1")
    until(lambda: user.record(wanted) == "")
    publisher.publish(joint_state(0))
    until(lambda: node._bag is not None and node._bag.messages)
    write, full = os.fsync, [True]

    def fsync(number: int) -> None:
        if full[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(number)

    monkeypatch.setattr("os.fsync", fsync)
    publisher.publish(joint_state(1))
    until(lambda: "has closed its bag" in user.fault(time.monotonic()))
    until(lambda: user.tick(time.monotonic()) or "a full disk" in user.fault(time.monotonic()))
    assert "goes on by itself" in user.fault(time.monotonic())
    full[0] = False
    until(lambda: user.fault(time.monotonic()) == "")
    publisher.publish(joint_state(2))
    until(lambda: node._bag.messages)
    user.close()
    assert len(list(wanted.directory.glob("*.mcap"))) > 1


def test_a_bag_that_is_deleted_is_told_at_once(spinning: Any, until: Callable[..., None], tmp_path: Path) -> None:
    _, client, _ = matched(spinning, until, tmp_path)
    user = listening(client)
    until(lambda: user.record(Wanted(tmp_path / "session" / "bag", "a" * 64, 0)) == "")
    shutil.rmtree(tmp_path / "session")
    until(lambda: "has closed its bag" in user.fault(time.monotonic()))
    assert not (tmp_path / "session").exists(), "nothing is made in the place of a session that is gone"


def test_readings_of_another_session_are_named_and_not_recorded(
    spinning: Any, until: Callable[..., None], tmp_path: Path
) -> None:
    node, client, _ = matched(spinning, until, tmp_path)
    readings = client.create_publisher(Reading, "calibration/reading", READING.qos)
    until(readings.get_subscription_count)
    user = listening(client)
    until(lambda: user.record(Wanted(tmp_path / "session" / "bag", "a" * 64, 0, "mine@1")) == "")
    until(readings.get_subscription_count)
    readings.publish(Reading(header=to_header(START), session="old@1"))
    until(lambda: node._foreign == "old@1")
    assert not node._bag.messages
    readings.publish(Reading(header=to_header(START), session="mine@1"))
    until(lambda: node._bag.messages == 1)


def test_places_that_cannot_be_used(context: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(Exception, match="expected a directory"):
        recorder(context, tmp_path / "file")


EXECUTABLE = ROOT / "install" / "calibration" / "lib" / "calibration" / "recorder"


@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_the_process_leaves_a_bag_that_can_be_read(
    spinning: Any, until: Callable[..., None], tmp_path: Path, source_environment: dict[str, str], kill: signal.Signals
) -> None:
    bag = tmp_path / "bag"
    command = [str(EXECUTABLE), "--ros-args", "-p", f"cell:={CELL_FILE}", "-p", f"out:={bag}"]
    process = subprocess.Popen(command, env=source_environment)
    try:
        client = spinning.plain()
        joints = client.create_publisher(JointState, "joint_states", 1000)
        tracker = client.create_publisher(PointStamped, "tracker/mp1", 1000)
        signs: list[bool] = []
        client.create_subscription(
            RECORDING.message, RECORDING.relative, lambda one: signs.append(one.recording), RECORDING.qos
        )
        until(lambda: joints.get_subscription_count() and tracker.get_subscription_count(), timeout=30.0)
        sent: list[float] = []
        sending = Granted(process.pid)
        for k in range(1500):
            joints.publish(joint_state(k))
            tracker.publish(point(k))
            sent.append(time.monotonic())
            time.sleep(0.001)
        if kill is not signal.SIGKILL:
            assert joints.wait_for_all_acked(Duration(seconds=20))
        lost = 1.0 + sending.waited  # s, what came last may wait for the disk, and for a core
        os.kill(process.pid, kill)
        killed, watch = time.monotonic(), Granted(process.pid)
        code = watch.until_ended(process)
        took = watch.seconds
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
    back = read_bag(bag, CELL)
    np.testing.assert_array_equal(back.joints.values, [q(k) for k in range(len(back.joints))])
    assert len(back.joints) >= sum(moment < killed - lost for moment in sent)
    if kill is signal.SIGKILL:
        assert code == -signal.SIGKILL
    else:
        assert code == 0
        until(lambda: not signs[-1])  # whoever moves the robot knows at once
        assert len(back.joints) == 1500
        assert "truncated" not in [note.kind for note in back.notes]
        assert took < 2.0


def test_a_bag_with_configurations_of_two_plans_is_refused(
    spinning: Any, until: Callable[..., None], tmp_path: Path
) -> None:
    """The same numbers mean different configurations."""
    node, client, publisher = matched(spinning, until, tmp_path)
    events = client.create_publisher(SessionEvent, EVENT.relative, EVENT.qos)
    tracker = client.create_publisher(PointStamped, "tracker/mp1", 100)
    until(lambda: events.get_subscription_count() and tracker.get_subscription_count())
    for k in range(50):
        publisher.publish(joint_state(k))
        tracker.publish(point(k))
    text, excluded = "mp2 by A. Smith: hidden", SessionEvent.POINT_EXCLUDED
    events.publish(SessionEvent(plan_sha256="a" * 64))
    events.publish(SessionEvent(plan_sha256="a" * 64, kind=excluded, configuration=3, text=text))
    for ahead in ("5.5", "5.6"):
        events.publish(SessionEvent(kind=SessionEvent.TRACKER_CLOCK, text=f"the tracker's clock is {ahead} s ahead"))
    until(lambda: node._bag.messages >= 104)
    moment = time.monotonic()
    until(lambda: node._written > moment)  # on the disk
    found = read_bag(tmp_path / "bag", CELL)
    assert found.provenance.plan_sha256 == "a" * 64
    assert Note("point_excluded", "configuration 3", text) in found.notes
    clocks = [note.text for note in found.notes if note.kind == "tracker_clock"]
    assert clocks == ["the tracker's clock is 5.6 s ahead; its stamps are corrected"]
    events.publish(SessionEvent(plan_sha256="b" * 64))
    until(lambda: node._bag.messages >= 105)
    moment = time.monotonic()
    until(lambda: node._written > moment)
    with pytest.raises(RecordingError, match=r"found configurations of 2 plans \(SHA-256 a{12}…, b{12}…\)"):
        read_bag(tmp_path / "bag", CELL)
