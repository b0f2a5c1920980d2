"""Arrays to bags: rosbag2 directories as a recorder would leave them."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import lz4.frame
import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from calibration_core.cell import Cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.recording.bags.metadata import METADATA, read_metadata
from calibration_core.recording.definitions.own import STEP_TYPE, TEXT_TYPE
from calibration_core.recording.messages.encode import encode
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.typed import standard_types
from calibration_core.timeseries import NANOSECONDS, StepMarkers, Streams, TimeSeries

Message = tuple[int, str, Any]  # receive time, topic, payload
COMPRESSIONS = (None, "zstd", "lz4", "zstd_file", "zstd_message")


def write_bag(
    path: Path,
    recording: Streams,
    cell: Cell,
    *,
    storage: Literal["mcap", "sqlite3"] = "mcap",
    compression: str | None = None,
    splits: int = 1,
) -> None:
    """Write a recording as a rosbag2 directory.

    Args:
        path: The directory to create.
        recording: What to write; stamps go to the headers, receive times to the bag.
        cell: Names of joints, points and topics.
        storage: Storage format.
        compression: `zstd` or `lz4` for the chunks of MCAP; `zstd_file` or `zstd_message` for rosbag2's own modes.
        splits: Number of storage files, of equal numbers of messages.

    Raises:
        ValueError: The combination of arguments does not exist.
        FileExistsError: The path exists.
    """
    if compression not in COMPRESSIONS or (storage == "sqlite3" and compression in ("zstd", "lz4")) or splits < 1:
        msg = f"storage={storage!r}, compression={compression!r}, splits={splits}"
        raise ValueError(msg)
    path = Path(path)
    if path.exists():
        raise FileExistsError(path)
    messages, types = _messages(recording, cell)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        parts = []
        bounds = np.linspace(0, len(messages), splits + 1).astype(int)
        for part in range(splits):
            target = Path(folder) / (path.name if splits == 1 else f"{path.name}_{part}")
            _write_part(target, messages[bounds[part] : bounds[part + 1]], types, storage, compression)
            parts.append(target)
        whole = parts[0] if splits == 1 else _joined(Path(folder) / path.name, parts)
        whole.rename(path)


def _write_part(
    path: Path, messages: list[Message], types: dict[str, str], storage: str, compression: str | None
) -> None:
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = Writer(path, version=9, storage_plugin=plugin)
    modes = {
        "zstd": CompressionMode.STORAGE,
        "zstd_file": CompressionMode.FILE,
        "zstd_message": CompressionMode.MESSAGE,
    }
    if compression in modes:
        writer.set_compression(modes[compression], CompressionFormat.ZSTD)
    with writer:
        if compression == "lz4" and isinstance(writer.storage, McapWriter):
            writer.storage.compression, writer.storage.compressor = "lz4", lz4.frame.compress
        connections = {
            topic: writer.add_connection(topic, kind, typestore=standard_types()) for topic, kind in types.items()
        }
        for received, topic, payload in messages:
            writer.write(connections[topic], received, payload)


def _joined(path: Path, parts: list[Path]) -> Path:
    """Move the storage files of several bags into one, with metadata that lists them all."""
    path.mkdir()
    whole: dict[str, Any] = {}
    for part in parts:
        one = read_metadata(part / METADATA)
        for name in one["relative_file_paths"]:
            shutil.move(part / name, path / name)
        if not whole:
            whole = one
            continue
        begin = min(_begin(whole), _begin(one))
        end = max(_begin(whole) + _duration(whole), _begin(one) + _duration(one))
        whole["starting_time"]["nanoseconds_since_epoch"] = begin
        whole["duration"]["nanoseconds"] = end - begin
        whole["message_count"] += one["message_count"]
        whole["relative_file_paths"] += one["relative_file_paths"]
        whole["files"] += one["files"]
        for mine, other in zip(whole["topics_with_message_count"], one["topics_with_message_count"], strict=True):
            mine["message_count"] += other["message_count"]
    text = yaml_text({"rosbag2_bagfile_information": whole})
    (path / METADATA).write_text(text, "utf-8")
    return path


def _begin(metadata: dict[str, Any]) -> int:
    return int(metadata["starting_time"]["nanoseconds_since_epoch"])


def _duration(metadata: dict[str, Any]) -> int:
    return int(metadata["duration"]["nanoseconds"])


def _messages(recording: Streams, cell: Cell) -> tuple[list[Message], dict[str, str]]:
    """Return all messages in the order they were received, and topic -> type."""
    topics = cell.topics
    messages: list[Message] = []
    types: dict[str, str] = {}
    series = {
        topics.joint_states: (StreamKind.JOINTS, recording.joints),
        topics.wrench: (StreamKind.WRENCH, recording.wrench),
        topics.temperature: (StreamKind.TEMPERATURE, recording.temperature),
        **{topics.point(name): (StreamKind.POINT, one) for name, one in recording.points.items()},
    }
    for topic, (kind, one) in series.items():
        if one is None:
            continue
        types[topic] = kind.value
        efforts = _efforts(recording, one) if kind is StreamKind.JOINTS else None
        payloads = encode(kind, one, cell.robot.joints, efforts)
        messages += zip(one.received.tolist(), [topic] * len(one), payloads, strict=True)
    if recording.robot_description:
        types[topics.robot_description] = TEXT_TYPE
        messages.append((min(message[0] for message in messages), topics.robot_description,
                         _serialize(TEXT_TYPE, data=recording.robot_description)))  # fmt: skip
    if recording.steps is not None:
        types[topics.step] = STEP_TYPE
        messages += [(time, topics.step, payload) for time, payload in _step_messages(recording.steps)]
    messages.sort(key=lambda message: message[0])
    return messages, types


def _efforts(recording: Streams, joints: TimeSeries) -> np.ndarray | None:
    efforts = recording.joint_efforts
    return efforts.values if efforts is not None and np.array_equal(efforts.time, joints.time) else None


def _serialize(kind: str, **fields: Any) -> memoryview:
    store = standard_types()
    return memoryview(store.serialize_cdr(store.types[kind](**fields), kind))


def _step_messages(steps: StepMarkers) -> Iterator[tuple[int, memoryview]]:
    types = standard_types().types
    for time, configuration, step, phase in zip(
        steps.time.tolist(), steps.configuration.tolist(), steps.step.tolist(), steps.phase.tolist(), strict=True
    ):
        stamp = types["builtin_interfaces/msg/Time"](sec=time // NANOSECONDS, nanosec=time % NANOSECONDS)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        yield time, _serialize(STEP_TYPE, header=header, configuration=configuration, step=step, phase=phase)
