"""The files of a bag: a directory with or without `metadata.yaml`, split or not, compressed or not, or a bare file."""

from __future__ import annotations

import dataclasses
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from calibration_core.errors import RecordingError, quoted
from calibration_core.files.names import NAME, is_name
from calibration_core.recording.bags.metadata import METADATA, information, metadata_file
from calibration_core.recording.bags.plan_hash import plan_of_metadata
from calibration_core.recording.source import BAG_SUFFIXES, COMPRESSED, ros1, storage_suffix
from calibration_core.recording.storage.batch import Batch, Channel, Storage
from calibration_core.recording.storage.compression import FREE_SHARE, decompress_file, decompress_message
from calibration_core.recording.storage.mcap import McapStorage
from calibration_core.recording.storage.sqlite import SqliteStorage
from calibration_core.timeseries import Note

MAX_FILES = 10_000
MAX_NAME = 255
ZSTD = b"\x28\xb5\x2f\xfd"  # begins a zstd frame; a serialised message begins with 0


@dataclasses.dataclass(frozen=True)
class BagFiles:
    """What belongs to a bag.

    Attributes:
        path: As the user named it.
        files: Storage files in their order, `.zst`/`.zstd` ones included.
        metadata: `metadata.yaml`, None if there is none.
        notes: What is missing.
        plan_sha256: SHA-256 of the plan that was measured, from the custom data; empty: not known.
    """

    path: Path
    files: tuple[Path, ...]
    metadata: Path | None
    notes: tuple[Note, ...]
    plan_sha256: str = ""


def bag_files(path: Path) -> BagFiles:
    """Find the files of a bag.

    Raises:
        RecordingError: There are none, or `metadata.yaml` cannot be used.
    """
    if not path.is_dir():
        return BagFiles(path, (path,), None, notes=())
    metadata = path / METADATA
    try:
        if not metadata.is_file():
            return _in_folder(path, "no metadata.yaml")
        if not metadata.read_bytes()[:1000].strip(b"\0 \t\r\n"):
            return _in_folder(path, "an empty metadata.yaml")
        return _from_metadata(path, metadata)
    except OSError as error:
        raise RecordingError(path, "", error.strerror or str(error), "a readable rosbag2 directory") from None


def _in_folder(path: Path, why: str, plan: str = "") -> BagFiles:
    """Return all storage files of a folder, with a note why none are listed."""
    there = [item for item in path.iterdir() if not item.name.startswith(".") and item.is_file()]
    files = sorted((item for item in there if storage_suffix(item) in BAG_SUFFIXES), key=_natural)
    older = next((item for item in there if item.suffix == ".bag"), None)
    if not files and older is not None:
        raise ros1(older)
    if not files:
        raise RecordingError(path, "", f"{why}, and no .mcap or .db3 file", "a rosbag2 directory")
    note = Note("no_metadata", path.name, f"{why}: all {len(files)} storage files of the directory are read")
    return BagFiles(path, tuple(files), None, notes=(note,), plan_sha256=plan)


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d{1,18})", path.name)]


def _from_metadata(path: Path, file: Path) -> BagFiles:
    content = metadata_file(file)
    with content.locating():
        return _listed(path, file, information(content))


def _listed(path: Path, file: Path, about: dict[str, Any]) -> BagFiles:
    names = about.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
        raise RecordingError(file, "relative_file_paths", quoted(names), "a list of file names")
    if len(names) > MAX_FILES:
        raise RecordingError(file, "relative_file_paths", f"{len(names)} files", f"at most {MAX_FILES}")
    files: dict[Path, None] = {}
    for i, name in enumerate(names):
        place = f"relative_file_paths.{i}"
        if len(name) > MAX_NAME or not is_name(name):
            raise RecordingError(file, place, quoted(name), f"a file name of at most {MAX_NAME} characters: {NAME}")
        one = path / PurePath(name).name
        if storage_suffix(one) not in BAG_SUFFIXES:
            raise RecordingError(file, place, quoted(one.name), ".mcap or .db3 files")
        if one in files:
            raise RecordingError(file, place, f"{quoted(one.name)} twice", "every file once")
        files[one] = None
    mode = str(about.get("compression_mode") or "none").lower()
    form = str(about.get("compression_format") or "").lower()
    if mode not in ("none", "file", "message"):
        raise RecordingError(file, "compression_mode", quoted(mode), "one of NONE, FILE, MESSAGE")
    if mode != "none" and form != "zstd":
        raise RecordingError(file, "compression_format", quoted(form), "zstd")
    there = [one for one in files if one.is_file()]
    missing = [one.name for one in files if one not in there]
    plan = plan_of_metadata(file, about.get("custom_data"))
    if not there:
        return _in_folder(path, f"{METADATA} names {quoted(missing[0])}, which does not exist", plan)
    text = f"{len(missing)} of {len(files)} storage files do not exist: {', '.join(missing[:3])}"
    notes = (Note("missing_file", path.name, text, len(missing)),) if missing else ()
    return BagFiles(path, tuple(there), file, notes=notes, plan_sha256=plan)


class BagStorage:
    """All the files of a bag, read one after another.

    Attributes:
        topics: Topic -> message type, of everything in the bag; complete after `batches`.
        notes: What was lost; complete after `batches`.
    """

    def __init__(self, bag: BagFiles) -> None:
        """Remember the files; nothing is opened before `batches`."""
        self.bag = bag
        self.topics: dict[str, str] = {}
        self.notes: list[Note] = list(bag.notes)

    def batches(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages on the given topics, in file order.

        Raises:
            RecordingError: A file cannot be used.
        """
        for file in self.bag.files:
            if file.suffix.lower() in COMPRESSED:
                yield from self._compressed(file, topics)
            else:
                yield from self._storage(file, file, topics)

    def _compressed(self, file: Path, topics: Collection[str]) -> Iterator[Batch]:
        with tempfile.TemporaryDirectory() as folder:
            plain = Path(folder) / file.stem
            try:
                with plain.open("wb") as target:
                    whole = decompress_file(file, target, FREE_SHARE * shutil.disk_usage(folder).free)
            except ValueError as error:
                raise RecordingError(file, "", str(error), "a zstd-compressed storage file") from None
            except OSError as error:
                raise RecordingError(
                    file, "", error.strerror or str(error), "a file that can be decompressed"
                ) from None
            if not whole:
                self.notes.append(Note("truncated", file.name, "the compressed file breaks off"))
            yield from self._storage(plain, file, topics)

    def _storage(self, file: Path, named: Path, topics: Collection[str]) -> Iterator[Batch]:
        storage: Storage = SqliteStorage(file) if file.suffix.lower() == ".db3" else McapStorage(file)
        try:
            for batch in storage.batches(topics):
                yield self._decompressed(batch)
        except RecordingError as error:
            if file is named:
                raise
            raise RecordingError(named, error.place, error.found, error.expected) from None
        self.notes += storage.notes
        for channel in storage.channels.values():
            self.topics.setdefault(channel.topic, channel.type)

    def _decompressed(self, batch: Batch) -> Batch:
        """Return a batch with plain messages: where one is compressed, all are, and begin with zstd's own mark."""
        if not len(batch) or batch.payload(0)[: len(ZSTD)] != ZSTD:
            return batch
        parts: list[bytes] = []
        rows: list[int] = []
        for row in range(len(batch)):
            try:
                parts.append(decompress_message(batch.payload(row)))
            except ValueError:
                continue
            rows.append(row)
        if len(rows) < len(batch):
            lost = len(batch) - len(rows)
            self.notes.append(Note("damaged", batch.channel.topic, f"{lost} messages cannot be decompressed", lost))
        length = np.array([len(part) for part in parts], np.int64)
        buffer = np.frombuffer(b"".join(parts), np.uint8)
        return Batch(batch.channel, buffer, np.cumsum(length) - length, length, batch.received[rows])


def type_error(file: Path, channel: Channel, expected: str) -> RecordingError:
    """Return the error for a topic that carries another message type."""
    if channel.encoding == "ros1":
        return ros1(file)
    return RecordingError(file, channel.topic, f"messages of type {quoted(channel.type)}", expected)
