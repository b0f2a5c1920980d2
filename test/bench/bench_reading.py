"""Bags to arrays: 1,000,000 WrenchStamped and a whole cell's streams, against rosbags' typed reader in the same run.

Times are processor times of single-threaded processes, so that other work on the machine does not count.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

MESSAGES = 1_000_000
SECONDS = 100  # of the whole cell
START = 1_700_000_000_000_000_000
REPEATS = 5
JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
STREAMS = {  # topic: kind, Hz, columns
    "/joint_states": ("JOINTS", 500, 6),
    "/force_torque/wrench": ("WRENCH", 1000, 6),
    "/tracker/mp1": ("POINT", 100, 3),
    "/tracker/mp2": ("POINT", 100, 3),
    "/tracker/mp3": ("POINT", 100, 3),
    "/cell/temperature": ("TEMPERATURE", 1, 1),
}
WRENCHES = {"/force_torque/wrench": ("WRENCH", 1000, 6)}


def _write(path: Path, storage: str, streams: dict[str, tuple[str, int, int]], seconds: float) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    from calibration_core.recording.messages.encode import encode
    from calibration_core.recording.messages.kinds import StreamKind
    from calibration_core.recording.messages.typed import standard_types
    from calibration_core.timeseries import TimeSeries

    rng = np.random.default_rng(0)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        messages = []
        for topic, (name, rate, columns) in streams.items():
            kind = StreamKind[name]
            stamp = START + np.arange(int(seconds * rate)) * (1_000_000_000 // rate)
            series = TimeSeries(stamp, rng.normal(size=(len(stamp), columns)), stamp + 1000, "a_frame")
            efforts = rng.normal(size=series.values.shape) if kind is StreamKind.JOINTS else None
            connection = writer.add_connection(topic, kind.value, typestore=standard_types())
            payloads = encode(kind, series, JOINTS, efforts)
            messages += zip(series.received.tolist(), [connection] * len(stamp), payloads, strict=True)
        if len(streams) > 1:
            messages.sort(key=lambda message: message[0])
        for received, connection, payload in messages:
            writer.write(connection, received, payload)


def _ours(path: Path, streams: dict[str, tuple[str, int, int]]) -> list[float]:
    from calibration_core.recording.bags.bag import read_contents
    from calibration_core.recording.bags.files import bag_files
    from calibration_core.recording.bags.streams import to_series
    from calibration_core.recording.messages.kinds import StreamKind

    kinds = {topic: StreamKind[name] for topic, (name, _, _) in streams.items()}
    times = []
    total = 0.0
    for _ in range(REPEATS):
        start = time.process_time()
        contents = read_contents(bag_files(path), kinds, JOINTS)
        series = {topic: to_series(samples, topic)[0] for topic, samples in contents.streams.items()}
        times.append(time.process_time() - start)
        total = sum(float(one.values.sum()) for one in series.values())
        count = sum(map(len, series.values()))
        del contents, series
    return [float(np.median(times)), times[0], count, total]


def _typed(path: Path, streams: dict[str, tuple[str, int, int]]) -> list[float]:
    from rosbags.highlevel import AnyReader

    def numbers(kind: str, message: object) -> list[float]:
        if kind == "JOINTS":
            return [*message.position]
        if kind == "POINT":
            return [message.point.x, message.point.y, message.point.z]
        if kind == "WRENCH":
            force, torque = message.wrench.force, message.wrench.torque
            return [force.x, force.y, force.z, torque.x, torque.y, torque.z]
        return [message.temperature]

    start = time.process_time()
    with AnyReader([path]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        arrays = {topic: np.empty((counts[topic], 2 + columns)) for topic, (_, _, columns) in streams.items()}
        rows = dict.fromkeys(streams, 0)
        for connection, received, raw in reader.messages():
            topic = connection.topic
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            row = [received, stamp.sec * 1_000_000_000 + stamp.nanosec, *numbers(streams[topic][0], message)]
            arrays[topic][rows[topic]] = row
            rows[topic] += 1
    spent = time.process_time() - start
    return [spent, spent, sum(rows.values()), sum(float(array[:, 2:].sum()) for array in arrays.values())]


def _run(role: str, path: Path, streams: dict[str, tuple[str, int, int]]) -> tuple[list[float], float]:
    """Run one reader in its own process: (median s, first s, messages, sum of all values), peak MB.

    A process starts with its parent's peak, so this one must stay small: bags are written in processes of their own.
    """
    command = [sys.executable, __file__, role, str(path), json.dumps(streams)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    *figures, kilobytes = (float(part) for part in done.stdout.split())
    return figures, kilobytes / 1024


def _write_apart(path: Path, storage: str, streams: dict[str, tuple[str, int, int]], seconds: int) -> None:
    subprocess.run([sys.executable, __file__, storage, str(path), json.dumps(streams), str(seconds)], check=True)


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


@pytest.mark.parametrize(("storage", "bar"), [("mcap", 20.0), ("sqlite3", 8.0)])
def test_a_million_wrenches(folder: Path, storage: str, bar: float) -> None:
    path = folder / f"wrenches_{storage}"
    _write_apart(path, storage, WRENCHES, MESSAGES // 1000)
    _compare(path, WRENCHES, f"1,000,000 WrenchStamped, {storage}", bar, MESSAGES)


@pytest.mark.parametrize(("storage", "bar"), [("mcap", 10.0), ("sqlite3", 5.0)])
def test_a_whole_cell(folder: Path, storage: str, bar: float) -> None:
    path = folder / f"cell_{storage}"
    _write_apart(path, storage, STREAMS, SECONDS)
    messages = SECONDS * sum(rate for _, rate, _ in STREAMS.values())
    _compare(path, STREAMS, f"{messages:,} messages of a whole cell, {storage}", bar, messages)


def _compare(path: Path, streams: dict[str, tuple[str, int, int]], title: str, bar: float, messages: int) -> None:
    ours, megabytes = _run("ours", path, streams)
    typed, _ = _run("typed", path, streams)
    assert ours[2] == typed[2] == messages
    assert abs(ours[3] - typed[3]) < 1e-6 * messages
    ratio = typed[0] / ours[0]
    print(
        f"\n{title}: {ours[0]:.3f} s (first {ours[1]:.3f} s), {megabytes:.0f} MB; typed reader {typed[0]:.2f} s; "
        f"{ratio:.1f}x faster ({typed[0] / ours[1]:.1f}x the first time)"
    )
    assert ratio >= bar
    assert megabytes <= 450.0


if __name__ == "__main__":
    role, where, what = sys.argv[1], Path(sys.argv[2]), json.loads(sys.argv[3])
    if role in ("mcap", "sqlite3"):
        _write(where, role, what, float(sys.argv[4]))
    else:
        figures = {"ours": _ours, "typed": _typed}[role](where, what)
        print(*figures, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
