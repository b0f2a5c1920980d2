"""Bags of every form give the arrays that were written, to the bit; damaged ones give what is whole."""

from __future__ import annotations

import dataclasses
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import RecordingError
from calibration_core.recording.bags.bag import iso_date, read_bag, read_contents
from calibration_core.recording.bags.files import bag_files
from calibration_core.recording.bags.writer import write_bag
from calibration_core.recording.messages.encode import encode
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.typed import standard_types
from calibration_core.recording.source import recording_kind, sha256_of
from calibration_core.timeseries import Streams, TimeSeries

Same = Callable[[Streams, Streams], None]
FORMS = [
    ("mcap", None), ("mcap", "zstd"), ("mcap", "lz4"), ("mcap", "zstd_file"), ("mcap", "zstd_message"),
    ("sqlite3", None), ("sqlite3", "zstd_file"), ("sqlite3", "zstd_message"),
]  # fmt: skip


@pytest.mark.parametrize("splits", [1, 3])
@pytest.mark.parametrize(("storage", "compression"), FORMS)
def test_round_trip(
    tmp_path: Path,
    cell: Cell,
    recording: Streams,
    same: Same,
    storage: str,
    compression: str | None,
    splits: int,
) -> None:
    bag = tmp_path / "bag"
    write_bag(bag, recording, cell, storage=storage, compression=compression, splits=splits)
    read = read_bag(bag, cell)
    same(read, recording)
    assert {note.kind for note in read.notes} <= {"gap"}
    assert read.provenance.kind == {"mcap": "mcap", "sqlite3": "db3"}[storage]
    assert read.provenance.start == "2023-11-14T22:13:20+00:00"
    assert read.provenance.messages["/force_torque/wrench"] == 600
    assert len(read.provenance.sha256) == splits + 1
    for name, digest in read.provenance.sha256.items():
        assert digest == sha256_of(bag / name)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_equal_to_the_typed_reader(tmp_path: Path, cell: Cell, recording: Streams, storage: str) -> None:
    write_bag(tmp_path / "bag", recording, cell, storage=storage)
    streams = {
        "/joint_states": StreamKind.JOINTS, "/tracker/left": StreamKind.POINT,
        "/force_torque/wrench": StreamKind.WRENCH, "/cell/temperature": StreamKind.TEMPERATURE,
    }  # fmt: skip
    fast, typed = (
        read_contents(bag_files(tmp_path / "bag"), streams, cell.robot.joints, fast=flag).streams
        for flag in (True, False)
    )
    for topic in streams:
        assert fast[topic].values.tobytes() == typed[topic].values.tobytes()
        assert np.array_equal(fast[topic].stamp, typed[topic].stamp)
        assert np.array_equal(fast[topic].received, typed[topic].received)


@pytest.mark.parametrize(("storage", "suffix"), [("mcap", ".mcap"), ("sqlite3", ".db3")])
def test_bare_file(tmp_path: Path, cell: Cell, recording: Streams, same: Same, storage: str, suffix: str) -> None:
    write_bag(tmp_path / "bag", recording, cell, storage=storage)
    same(read_bag(tmp_path / "bag" / f"bag{suffix}", cell), recording)


def test_directory_without_metadata_is_read_in_natural_order(
    tmp_path: Path, cell: Cell, recording: Streams, same: Same
) -> None:
    write_bag(tmp_path / "bag", recording, cell, splits=12)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    read = read_bag(tmp_path / "bag", cell)
    same(read, recording)
    assert not any(note.kind == "out_of_order" for note in read.notes)
    assert any(note.kind == "no_metadata" for note in read.notes)


def test_missing_split_is_reported(tmp_path: Path, cell: Cell, recording: Streams) -> None:
    write_bag(tmp_path / "bag", recording, cell, splits=3)
    (tmp_path / "bag" / "bag_1.mcap").unlink()
    read = read_bag(tmp_path / "bag", cell)
    assert [note.count for note in read.notes if note.kind == "missing_file"] == [1]
    assert 0 < len(read.joints) < len(recording.joints)


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"chunk_size": 3000, "use_statistics": False}])
def test_files_of_another_writer(
    tmp_path: Path, cell: Cell, recording: Streams, compression: CompressionType, options: dict[str, bool]
) -> None:
    """With checksums, other chunk sizes, no chunks, no index."""
    path = tmp_path / "other.mcap"
    other_writer(path, cell, recording, compression=compression, **options)
    read = read_bag(path, cell)
    assert read.joints.values.tobytes() == recording.joints.values.tobytes()
    assert read.points["left"].values.tobytes() == recording.points["left"].values.tobytes()
    assert {note.kind for note in read.notes} <= {"gap", "missing_point"}


def other_writer(path: Path, cell: Cell, recording: Streams, **options: object) -> None:
    definitions = {
        kind: standard_types().generate_msgdef(kind.value, ros_version=2)[0]
        for kind in (StreamKind.JOINTS, StreamKind.POINT)
    }
    streams = {
        "/joint_states": (StreamKind.JOINTS, recording.joints),
        "/tracker/left": (StreamKind.POINT, recording.points["left"]),
    }
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start("ros2", "test")
        messages = []
        for topic, (kind, series) in streams.items():
            schema = writer.register_schema(kind.value, "ros2msg", definitions[kind].encode())
            channel = writer.register_channel(topic, "cdr", schema)
            payloads = encode(kind, series, cell.robot.joints, None)
            messages += [(t, channel, bytes(data)) for t, data in zip(series.received.tolist(), payloads, strict=True)]
        for time, channel, data in sorted(messages):
            writer.add_message(channel, time, data, time)
        writer.finish()


@pytest.mark.parametrize("compression", [None, "zstd", "lz4"])
def test_cut_off_at_any_place(tmp_path: Path, cell: Cell, compression: str | None, big: Streams) -> None:
    """Every cut gives a beginning of the recording, and a later cut never gives less."""
    write_bag(tmp_path / "bag", big, cell, compression=compression)
    whole = (tmp_path / "bag" / "bag.mcap").read_bytes()
    reference = np.sort(big.joints.time)
    before = 0
    for share in (0.15, 0.3, 0.45, 0.6, 0.75, 0.9):
        path = tmp_path / "cut.mcap"
        path.write_bytes(whole[: int(len(whole) * share)])
        read = read_bag(path, cell)
        assert any(note.kind == "truncated" for note in read.notes)
        assert np.array_equal(read.joints.time, reference[: len(read.joints)])
        assert len(read.joints) >= before
        before = len(read.joints)
    assert before > 0.5 * len(reference)


@pytest.fixture(scope="module")
def big() -> Streams:
    """Return a recording of several chunks, in which joint states arrive in the order of their stamps."""
    rng = np.random.default_rng(1)
    start = 1_700_000_000_000_000_000

    def series(count: int, columns: int) -> TimeSeries:
        time = start + np.arange(count) * (20_000_000_000 // count)
        return TimeSeries(time, rng.normal(size=(count, columns)), time + 1000, "f")

    empty = Streams(series(8000, 3), {}, None, None, None, "", None)  # type: ignore[arg-type]
    return dataclasses.replace(empty, points={"left": series(4000, 3)}, wrench=series(20_000, 6))


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_database_cut_off(tmp_path: Path, cell: Cell, big: Streams, share: float) -> None:
    write_bag(tmp_path / "bag", big, cell, storage="sqlite3")
    path = tmp_path / "bag" / "bag.db3"
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    read = read_bag(path, cell)
    assert any(note.kind == "truncated" for note in read.notes)
    assert np.array_equal(read.joints.values, big.joints.values[: len(read.joints)])
    assert len(read.joints) > 0.95 * share * len(big.joints)


def test_database_with_a_damaged_page(tmp_path: Path, cell: Cell, big: Streams) -> None:
    """Inner pages lost: the leaves tell for themselves."""
    write_bag(tmp_path / "bag", big, cell, storage="sqlite3")
    path = tmp_path / "bag" / "bag.db3"
    data = bytearray(path.read_bytes())
    inner = [at for at in range(0, len(data), 4096) if data[at] == 5]
    for at in inner[1:]:
        data[at : at + 4096] = bytes(4096)
    path.write_bytes(data)
    read = read_bag(path, cell)
    assert any(note.kind == "truncated" for note in read.notes)
    assert np.array_equal(read.joints.values, big.joints.values)


def test_log_of_a_killed_recorder(tmp_path: Path, cell: Cell, recording: Streams, same: Same) -> None:
    """Messages that are still in the write-ahead log are read, and nothing in the folder changes."""
    write_bag(tmp_path / "bag", recording, cell, storage="sqlite3")
    live = tmp_path / "live.db3"
    shutil.copy(tmp_path / "bag" / "bag.db3", live)
    database = sqlite3.connect(live)
    database.execute("PRAGMA journal_mode=WAL")
    rows = database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id").fetchall()
    database.execute("DELETE FROM messages")
    database.commit()
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    database.commit()
    folder = tmp_path / "killed"
    folder.mkdir()
    for suffix in ("", "-wal"):
        shutil.copy(tmp_path / f"live.db3{suffix}", folder / f"live.db3{suffix}")
    database.close()
    before = {path.name: sha256_of(path) for path in folder.iterdir()}
    same(read_bag(folder / "live.db3", cell), recording)
    assert {path.name: sha256_of(path) for path in folder.iterdir()} == before


def test_damaged_chunk_is_left_out(tmp_path: Path, cell: Cell, big: Streams) -> None:
    other_writer(tmp_path / "a.mcap", cell, big, compression=CompressionType.ZSTD, chunk_size=100_000)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    second = data.index(b"zstd", data.index(b"zstd") + 1)
    data[second + 1000] ^= 0x10
    (tmp_path / "a.mcap").write_bytes(data)
    read = read_bag(tmp_path / "a.mcap", cell)
    assert [note.kind for note in read.notes if note.kind == "damaged"] == ["damaged"]
    assert 0.7 * len(big.joints) < len(read.joints) < len(big.joints)


def test_zeros_at_the_end_are_a_cut(tmp_path: Path, cell: Cell, big: Streams) -> None:
    """A file system that lost power leaves zeros where data should be."""
    write_bag(tmp_path / "bag", big, cell)
    path = tmp_path / "bag" / "bag.mcap"
    data = path.read_bytes()
    half = len(data) // 2
    path.write_bytes(data[:half] + bytes(half))
    read = read_bag(path, cell)
    assert {"truncated", "damaged"} & {note.kind for note in read.notes}
    assert len(read.joints) > 0.3 * len(big.joints)


def other_topic(path: Path, encoding: str = "cdr", kind: str = "sensor_msgs/msg/Image") -> None:
    """Write 100 black images, which shrink ten thousandfold, as a covered camera leaves them."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start("ros2", "camera")
        schema = writer.register_schema(kind, "ros2msg", b"")
        channel = writer.register_channel("/joint_states" if encoding == "ros1" else "/camera", encoding, schema)
        for i in range(100):
            writer.add_message(channel, i, bytes(640 * 480 * 3), i)
        writer.finish()


@pytest.mark.parametrize("packed", [False, True])
def test_a_camera_that_sees_nothing_does_not_matter(
    tmp_path: Path, cell: Cell, recording: Streams, same: Same, packed: bool
) -> None:
    bag = tmp_path / "bag"
    write_bag(bag, recording, cell)
    (bag / "metadata.yaml").unlink()
    other_topic(bag / "camera.mcap")
    if packed:
        for file in bag.glob("*.mcap"):
            file.with_suffix(".mcap.zst").write_bytes(zstandard.compress(file.read_bytes()))
            file.unlink()
    same(read_bag(bag, cell), recording)


def emptied(bag: Path) -> None:
    (bag / "metadata.yaml").write_bytes(bytes(4096))  # as a computer leaves it that lost its power


def renamed(bag: Path) -> None:
    for file in bag.glob("bag*"):
        file.rename(bag / file.name.replace("bag", "monday").replace(".db3", ".DB3"))


def packed_by_hand(bag: Path) -> None:
    file = next(bag.glob("bag.*"))
    file.with_name(f"{file.name}.zst").write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()


def copied_on_a_mac(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    (bag / "._bag.mcap").write_bytes(b"\x00\x05\x16\x07")


@pytest.mark.parametrize("change", [emptied, renamed, packed_by_hand, copied_on_a_mac])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_people_do_to_bags(
    tmp_path: Path, cell: Cell, recording: Streams, same: Same, storage: str, change: Callable[[Path], None]
) -> None:
    write_bag(tmp_path / "bag", recording, cell, storage=storage)
    change(tmp_path / "bag")
    read = read_bag(tmp_path / "bag", cell)
    same(read, recording)
    assert [note.kind for note in read.notes if note.kind != "gap"] == ["no_metadata"]
    single = next(file for file in (tmp_path / "bag").iterdir() if "yaml" not in file.name and file.name[0] != ".")
    assert recording_kind(single) == "bag"
    same(read_bag(single, cell), recording)


def test_messages_that_are_compressed_need_no_metadata(
    tmp_path: Path, cell: Cell, recording: Streams, same: Same
) -> None:
    for storage in ("mcap", "sqlite3"):
        write_bag(tmp_path / storage, recording, cell, storage=storage, compression="zstd_message")
        (tmp_path / storage / "metadata.yaml").unlink()
        same(read_bag(tmp_path / storage, cell), recording)


def test_bags_of_ros_1_are_named_as_such(tmp_path: Path, cell: Cell) -> None:
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    other_topic(tmp_path / "old.mcap", "ros1", "sensor_msgs/JointState")
    for read in (recording_kind, lambda path: read_bag(path.parent, cell)):
        (tmp_path / "alone").mkdir(exist_ok=True)
        (tmp_path / "alone" / "old.bag").touch()
        with pytest.raises(RecordingError, match=r"a bag of ROS 1, expected one of ROS 2: rosbags-convert --src"):
            read(tmp_path / "alone" / "old.bag")
    with pytest.raises(RecordingError, match="a bag of ROS 1"):
        read_bag(tmp_path / "old.mcap", cell)


def test_a_temperature_of_another_type_is_not_needed(tmp_path: Path, cell: Cell, recording: Streams) -> None:
    write_bag(tmp_path / "bag", recording, cell)
    (tmp_path / "warm.yaml").write_text(
        cell.path.read_text() + "topics: {temperature: /force_torque/wrench, wrench: /w}\n"
    )
    read = read_bag(tmp_path / "bag", load_cell(tmp_path / "warm.yaml"))
    assert read.temperature is None
    assert [note.place for note in read.notes if note.kind == "other_type"] == ["/force_torque/wrench"]


def test_other_topics_do_not_matter(tmp_path: Path, cell: Cell, recording: Streams) -> None:
    """Names and points that this cell does not know are not read."""
    write_bag(tmp_path / "bag", recording, cell)
    text = cell.path.read_text().replace("left: [0.1, 0, 0], right", "right")
    (tmp_path / "one.yaml").write_text(text + "topics: {wrench: /elsewhere}\n")
    read = read_bag(tmp_path / "bag", load_cell(tmp_path / "one.yaml"))
    assert set(read.points) == {"right"}
    assert read.wrench is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("topics: {joint_states: /joints}", r"/joints: found no messages \(in the bag: .*/joint_states"),
        ("topics: {/tracker/left: /l, /tracker/right: /r}", r"tracker: found no messages .* on /l, /r"),
        ("topics: {wrench: /tracker/left, /tracker/left: /l}", "/tracker/left: found messages of type"),
        ("topics: {joint_states: /tracker/left, /tracker/left: /l}", "expected sensor_msgs/msg/JointState"),
        ("topics: {step: /joint_states, joint_states: /j}", "expected calibration_interfaces/msg/MeasurementStep"),
        ("joints: [shoulder, elbow, other]", "found the joints shoulder, elbow, wrist, expected positions of"),
    ],
)
def test_topics_that_do_not_fit(tmp_path: Path, cell: Cell, recording: Streams, change: str, message: str) -> None:
    write_bag(tmp_path / "bag", recording, cell)
    text = cell.path.read_text()
    if change.startswith("joints"):
        text = text.replace("joints: [shoulder, elbow, wrist]", change)
    else:
        text += change + "\n"
    (tmp_path / "other.yaml").write_text(text)
    with pytest.raises(RecordingError, match=message) as caught:
        read_bag(tmp_path / "bag", load_cell(tmp_path / "other.yaml"))
    assert "\n" not in str(caught.value)


def test_joints_in_another_order_and_more_of_them(tmp_path: Path, cell: Cell, recording: Streams) -> None:
    write_bag(tmp_path / "bag", recording, cell)
    text = cell.path.read_text().replace("[shoulder, elbow, wrist]", "[wrist, shoulder, elbow]")
    (tmp_path / "turned.yaml").write_text(text)
    read = read_bag(tmp_path / "bag", load_cell(tmp_path / "turned.yaml"))
    assert np.array_equal(read.joints.values, recording.joints.values[:, [2, 0, 1]])


def test_written_bags_can_be_read_by_rosbags(tmp_path: Path, cell: Cell, recording: Streams) -> None:
    from rosbags.highlevel import AnyReader

    write_bag(tmp_path / "bag", recording, cell, splits=2)
    with AnyReader([tmp_path / "bag"]) as reader:
        steps = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/calibration/step"
        ]
        count = reader.message_count
    assert [(m.configuration, m.step, m.phase) for m in steps] == [(1, 0, 0), (1, 0, 3), (1, 1, 1), (1, 1, 5)]
    assert count == 200 + 100 + 66 + 600 + 5 + 4 + 1


def test_writer_refuses(tmp_path: Path, cell: Cell, recording: Streams) -> None:
    with pytest.raises(ValueError, match="sqlite3"):
        write_bag(tmp_path / "bag", recording, cell, storage="sqlite3", compression="lz4")
    (tmp_path / "bag").mkdir()
    with pytest.raises(FileExistsError):
        write_bag(tmp_path / "bag", recording, cell)


def test_dates() -> None:
    assert iso_date(1_700_000_000 * 10**9) == "2023-11-14T22:13:20+00:00"
    assert iso_date(12 * 10**9) == ""
    assert iso_date(np.iinfo(np.int64).max) != ""
