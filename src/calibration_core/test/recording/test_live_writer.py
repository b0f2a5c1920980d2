"""A bag written while things happen: readable at any moment, whatever happens to the writer."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from calibration_core.cell import load_cell
from calibration_core.errors import OutputError
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.bags.live_writer import LiveBag, LiveTopic
from calibration_core.recording.messages.encode import encode
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.typed import standard_types
from calibration_core.timeseries import TimeSeries

CELL = load_cell(Path(__file__).resolve().parents[4] / "config" / "cells" / "demo.cell.yaml")
START = 1_700_000_000_000_000_000
MS = 1_000_000
NEVER = {"sec": 9223372036, "nsec": 854775807}
QOS = {
    "history": "keep_last",
    "depth": 2000,
    "reliability": "reliable",
    "durability": "volatile",
    "deadline": NEVER,
    "lifespan": NEVER,
    "liveliness": "automatic",
    "liveliness_lease_duration": NEVER,
    "avoid_ros_namespace_conventions": False,
}


def payloads(kind: StreamKind, width: int, n: int, seed: int) -> tuple[TimeSeries, list[bytes]]:
    time_ns = START + MS * np.arange(n)
    values = np.random.default_rng(seed).standard_normal((n, width))
    series = TimeSeries(time_ns, values, time_ns + 1000, "f")
    return series, [bytes(one) for one in encode(kind, series, CELL.robot.joints, None)]


def type_hash(kind: StreamKind) -> str:
    return str(standard_types().hash_rihs01(kind.value))


def add(bag: LiveBag, name: str, kind: StreamKind) -> int:
    text = standard_types().generate_msgdef(kind.value)[0]
    return bag.add_topic(LiveTopic(name, kind.value, text, type_hash(kind), (QOS,)))


def fill(bag: LiveBag, n: int = 50, seed: int = 0) -> tuple[TimeSeries, TimeSeries]:
    joints, q = payloads(StreamKind.JOINTS, 6, n, seed)
    points, p = payloads(StreamKind.POINT, 3, n, seed + 1)
    numbers = add(bag, "/joint_states", StreamKind.JOINTS), add(bag, "/tracker/mp1", StreamKind.POINT)
    for k in range(n):
        bag.write(numbers[0], START + MS * k + 1000, q[k])
        bag.write(numbers[1], START + MS * k + 1000, p[k])
    return joints, points


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_round_trip(tmp_path: Path, compression: str) -> None:
    bag = LiveBag(tmp_path / "bag", compression)  # type: ignore[arg-type]
    joints, points = fill(bag)
    bag.close()
    back = read_bag(tmp_path / "bag", CELL)
    np.testing.assert_array_equal(back.joints.values, joints.values)
    np.testing.assert_array_equal(back.joints.time, joints.time)
    np.testing.assert_array_equal(back.joints.received, joints.received)
    np.testing.assert_array_equal(back.points["mp1"].values, points.values)
    assert [note.kind for note in back.notes] == ["missing_point"]


def test_other_readers_agree(tmp_path: Path) -> None:
    bag = LiveBag(tmp_path / "bag")
    joints, _ = fill(bag)
    bag.close()
    with AnyReader([tmp_path / "bag"]) as reader:
        assert {c.topic: (c.msgcount, c.digest) for c in reader.connections} == {
            "/joint_states": (50, type_hash(StreamKind.JOINTS)),
            "/tracker/mp1": (50, type_hash(StreamKind.POINT))}  # fmt: skip
        states = [reader.deserialize(raw, c.msgtype).position for c, _, raw in reader.messages() if "joint" in c.topic]
    np.testing.assert_array_equal(np.array(states), joints.values)
    with bag.file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 100
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert channels["/joint_states"].metadata["topic_type_hash"] == type_hash(StreamKind.JOINTS)
    assert yaml.safe_load(channels["/joint_states"].metadata["offered_qos_profiles"]) == [QOS]
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert metadata["version"] == 9
    assert metadata["message_count"] == 100
    assert metadata["starting_time"]["nanoseconds_since_epoch"] == START + 1000
    assert metadata["duration"]["nanoseconds"] == 49 * MS


def test_what_is_synced_can_be_read_while_the_bag_is_open(tmp_path: Path) -> None:
    bag = LiveBag(tmp_path / "bag")
    joints, _ = fill(bag)
    bag.sync()
    back = read_bag(tmp_path / "bag", CELL)
    np.testing.assert_array_equal(back.joints.values, joints.values)
    assert "truncated" in [note.kind for note in back.notes]
    bag.close()


def test_a_bag_that_is_there_is_continued(tmp_path: Path) -> None:
    first = LiveBag(tmp_path / "bag")
    fill(first)
    first.sync()
    first._stream.close()  # as a killed process leaves it
    second = LiveBag(tmp_path / "bag")
    assert second.file.name == "bag_1.mcap"
    _, q = payloads(StreamKind.JOINTS, 6, 80, 7)
    number = add(second, "/joint_states", StreamKind.JOINTS)
    for k in range(60, 80):
        second.write(number, START + MS * k + 1000, q[k])
    second.close()
    back = read_bag(tmp_path / "bag", CELL)
    assert len(back.joints) == 70
    assert back.provenance.sha256.keys() == {"bag_0.mcap", "bag_1.mcap", "metadata.yaml"}


WRITE_FOR_EVER = """
import sys
from pathlib import Path
sys.path.insert(0, {here!r})
from test_live_writer import LiveBag, START, MS, StreamKind, add, payloads
bag = LiveBag(Path({bag!r}))
numbers = add(bag, "/joint_states", StreamKind.JOINTS), add(bag, "/tracker/mp1", StreamKind.POINT)
q, p = payloads(StreamKind.JOINTS, 6, 200000, 0)[1], payloads(StreamKind.POINT, 3, 200000, 1)[1]
for k in range(200000):
    bag.write(numbers[0], START + MS * k + 1000, q[k])
    bag.write(numbers[1], START + MS * k + 1000, p[k])
    if k % 100 == 99:
        bag.sync()
        print(k + 1, flush=True)
"""


@pytest.mark.parametrize("seed", range(3))
def test_kill_9_loses_nothing_that_was_synced(tmp_path: Path, seed: int) -> None:
    code = WRITE_FOR_EVER.format(here=str(Path(__file__).parent), bag=str(tmp_path / "bag"))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline()
    time.sleep(float(np.random.default_rng(seed).uniform(0.05, 0.5)))
    os.kill(process.pid, signal.SIGKILL)
    synced = [100, *map(int, process.stdout.read().split())][-1]
    process.wait()
    back = read_bag(tmp_path / "bag", CELL)
    assert len(back.joints) >= synced
    np.testing.assert_array_equal(
        back.joints.values, payloads(StreamKind.JOINTS, 6, 200000, 0)[0].values[: len(back.joints)]
    )


def test_places_that_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("x")
    with pytest.raises(OutputError, match=r"notes.txt: found a directory with other files"):
        LiveBag(tmp_path / "other")
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="file"):
        LiveBag(tmp_path / "file")
    with pytest.raises(OutputError, match="file"):
        LiveBag(tmp_path / "file" / "below")
