"""A bag that is written while things happen, and that can be read whatever happens to the writer.

Storage is MCAP; what was written is on the disk after every `sync`: the chunk is closed, the file flushed and synced.
`metadata.yaml` is there from the start, so that the directory is a rosbag2 from the start, and is replaced at the end.
A directory that holds a bag already is continued with a further file, as rosbag2 does when it splits: what a writer
that was killed has left stays as it is.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
from pathlib import Path
from typing import Any, Literal

import yaml
from mcap.writer import CompressionType, Writer

from calibration_core.errors import InputError, OutputError, storage_fault
from calibration_core.recording.bags.metadata import METADATA, read_metadata
from calibration_core.recording.bags.plan_hash import KEY, plan_of_metadata

CHUNK = 4 << 20
Compression = Literal["none", "lz4", "zstd"]
_COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}


@dataclasses.dataclass(frozen=True)
class LiveTopic:
    """What a bag says of a topic.

    Attributes:
        type: `package/msg/Name`.
        definition: Its definition with those of the types in it (`ros2msg`), empty if unknown.
        type_hash: RIHS01 hash, empty if unknown.
        qos: Offered qualities as rosbag2 writes them, one mapping per publisher.
    """

    name: str
    type: str
    definition: str = ""
    type_hash: str = ""
    qos: tuple[Any, ...] = ()


class LiveBag:
    """A bag under way.

    Attributes:
        path: The directory.
        file: The storage file being written.
        plan_sha256: Of the plan that the bag's configurations are of; empty: not known.
    """

    def __init__(self, path: Path, compression: Compression = "none", plan_sha256: str = "") -> None:
        """Make the directory, or continue the bag in it with a further file.

        Args:
            path: The directory.
            compression: Of the chunks.
            plan_sha256: Of the plan that is measured; empty: not known.

        Raises:
            OutputError: The directory cannot be made or written, holds something else, or the bag of another plan.
        """
        self.path = Path(path)
        self.plan_sha256 = _same_plan(self.path, _plan_of(self.path), plan_sha256)
        earlier = _earlier(self.path)
        number = max((int(found[2]) for found in earlier), default=-1) + 1
        self.file = self.path / f"{self.path.name}_{number}.mcap"
        self._earlier = [found[0] for found in earlier]
        self._topics: list[LiveTopic] = []
        self._counts: list[int] = []
        self._channels: list[int] = []
        self._begin, self._end = 0, 0
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._stream = self.file.open("xb")
            self._writer = Writer(self._stream, chunk_size=CHUNK, compression=_COMPRESSIONS[compression])
            self._writer.start(profile="ros2", library="calibration")
            self._name_plan()
            self._write_metadata()
            self.sync()
        except OSError as error:
            raise self._error(error) from None

    def belong_to(self, plan_sha256: str) -> None:
        """Say which plan the bag's configurations are of, where it was begun without one.

        Raises:
            OutputError: They are of another plan, or the file cannot be written.
        """
        if self.plan_sha256 == _same_plan(self.path, self.plan_sha256, plan_sha256):
            return
        self.plan_sha256 = plan_sha256
        try:
            self._name_plan()
            self._write_metadata()
        except OSError as error:
            raise self._error(error) from None

    def _name_plan(self) -> None:
        """Write the plan's hash into the storage file, which may be parted from its metadata."""
        if self.plan_sha256:
            self._writer.add_metadata("calibration", {KEY: self.plan_sha256})

    @property
    def messages(self) -> int:
        """Messages written to this file."""
        return sum(self._counts)

    def add_topic(self, topic: LiveTopic) -> int:
        """Announce a topic; return the number by which `write` knows it."""
        encoding = "ros2msg" if topic.definition else ""
        schema = self._writer.register_schema(topic.type, encoding, topic.definition.encode())
        metadata = {"offered_qos_profiles": yaml.safe_dump(list(topic.qos), sort_keys=False) if topic.qos else ""}
        if topic.type_hash:
            metadata["topic_type_hash"] = topic.type_hash
        self._channels.append(self._writer.register_channel(topic.name, "cdr", schema, metadata))
        self._topics.append(topic)
        self._counts.append(0)
        return len(self._topics) - 1

    def write(self, topic: int, received: int, payload: bytes) -> None:
        """Write a message.

        Args:
            topic: Number of the topic, from `add_topic`.
            received: Receive time, ns, not negative.
            payload: The message as it came, CDR with its encapsulation header.

        Raises:
            OutputError: The file cannot be written.
        """
        try:
            self._writer.add_message(self._channels[topic], received, payload, received, self._counts[topic])
        except OSError as error:
            raise self._error(error) from None
        if not self.messages:
            self._begin = self._end = received
        self._begin, self._end = min(self._begin, received), max(self._end, received)
        self._counts[topic] += 1

    def sync(self) -> None:
        """Bring everything written so far onto the disk.

        Raises:
            OutputError: The file cannot be written.
        """
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise self._error(error) from None
        if not self.there:
            raise OutputError(self.file, "", "another file in its place, or none", "the file that is being written")

    @property
    def there(self) -> bool:
        """Whether what is written can be found at its place."""
        with contextlib.suppress(OSError):
            return os.path.samestat(self.file.stat(), os.fstat(self._stream.fileno()))
        return False

    def leave(self) -> None:
        """Let go of a file that cannot be written any more; what is on the disk stays."""
        with contextlib.suppress(OSError):  # it was told already
            self._stream.close()

    def close(self) -> None:
        """End the file with its index, and bring the metadata up to date.

        Raises:
            OutputError: The file cannot be written.
        """
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._stream.close()
            self._write_metadata()
        except OSError as error:
            raise self._error(error) from None

    def _error(self, error: OSError) -> OutputError:
        return OutputError(self.file, "", *storage_fault(self.file, error, "a directory that can be written"))

    def _write_metadata(self) -> None:
        begin, duration = {"nanoseconds_since_epoch": self._begin}, {"nanoseconds": self._end - self._begin}
        own = {"path": self.file.name, "starting_time": begin, "duration": duration, "message_count": self.messages}
        old = [entry for entry in _old_files(self.path) if entry.get("path") in self._earlier]
        content = {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": begin,
            "message_count": self.messages,
            "topics_with_message_count": [
                {"topic_metadata": _topic_metadata(topic), "message_count": count}
                for topic, count in zip(self._topics, self._counts, strict=True)
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [*self._earlier, self.file.name],
            "files": [*old, own],
            "custom_data": {KEY: self.plan_sha256} if self.plan_sha256 else {},
            "ros_distro": "jazzy",
        }
        if old:  # the bag as a whole began with its first file
            first = min(entry["starting_time"]["nanoseconds_since_epoch"] for entry in [*old, own])
            content["starting_time"] = {"nanoseconds_since_epoch": first}
            content["duration"] = {"nanoseconds": max(self._end - first, 0)}
            content["message_count"] = sum(entry["message_count"] for entry in [*old, own])
        text = yaml.dump({"rosbag2_bagfile_information": content}, Dumper=_Plain, sort_keys=False)
        temporary = self.path / f".{METADATA}"
        with temporary.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(self.path / METADATA)


class _Plain(yaml.SafeDumper):  # type: ignore[misc]  # yaml has no types
    """YAML without anchors: the same mapping may stand in several places."""

    def ignore_aliases(self, _data: object) -> bool:
        return True


def _topic_metadata(topic: LiveTopic) -> dict[str, object]:
    return {
        "name": topic.name,
        "type": topic.type,
        "serialization_format": "cdr",
        "offered_qos_profiles": list(topic.qos),
        "type_description_hash": topic.type_hash,
    }


def _earlier(path: Path) -> list[tuple[str, str, str]]:
    """Return name, stem and number of the storage files that are there."""
    if not path.exists():
        return []
    try:
        names = sorted(item.name for item in path.iterdir())
    except OSError as error:
        raise OutputError(path, "", error.strerror or str(error), "a directory for a bag") from None
    found = [(name, match[1], match[2]) for name in names if (match := re.fullmatch(r"(.+)_(\d{1,9})\.mcap", name))]
    foreign = [name for name in names if not name.endswith(".mcap") and name not in (METADATA, f".{METADATA}")]
    if foreign:
        raise OutputError(path, foreign[0], "a directory with other files", "an empty directory or a bag")
    return sorted(found, key=lambda one: int(one[2]))


def _plan_of(path: Path) -> str:
    """Return the plan's hash in the metadata so far; empty if there is none that can be read."""
    try:
        custom = read_metadata(path / METADATA).get("custom_data")
    except InputError:
        return ""
    try:
        return plan_of_metadata(path / METADATA, custom)
    except InputError as error:
        raise OutputError(error.file, error.place, error.found, error.expected) from None


def _same_plan(path: Path, known: str, new: str) -> str:
    """Return the hash of the one plan that both name; raise OutputError if they differ."""
    if known and new and known != new:
        found, expected = f"the bag of another plan (SHA-256 {known[:12]}…)", f"one of this plan, {new[:12]}…"
        raise OutputError(path, "plan", found, expected)
    return new or known


def _old_files(path: Path) -> list[dict[str, Any]]:
    """Return what the metadata so far says of its files; nothing if there is none that can be read."""
    try:
        files = read_metadata(path / METADATA)["files"]
        return [entry for entry in files if int(entry["starting_time"]["nanoseconds_since_epoch"]) >= 0]
    except (InputError, KeyError, TypeError, ValueError):
        return []
