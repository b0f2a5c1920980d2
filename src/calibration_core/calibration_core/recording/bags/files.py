"""The files of a bag: a directory with or without `metadata.yaml`, split or not, compressed or not, or a bare file."""

from __future__ import annotations

import dataclasses
import re
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from calibration_core.errors import RecordingError, quoted
from calibration_core.files.names import NAME, is_name
from calibration_core.recording.bags.metadata import METADATA, information, metadata_file
from calibration_core.recording.bags.plan_hash import plan_of_metadata
from calibration_core.recording.source import BAG_SUFFIXES
from calibration_core.recording.storage.batch import Batch, Channel, Storage
from calibration_core.recording.storage.compression import decompress_file, decompress_message
from calibration_core.recording.storage.mcap import McapStorage
from calibration_core.recording.storage.sqlite import SqliteStorage
from calibration_core.timeseries import Note

MAX_FILES = 10_000
MAX_NAME = 255


@dataclasses.dataclass(frozen=True)
class BagFiles:
    """What belongs to a bag.

    Attributes:
        path: As the user named it.
        files: Storage files in their order, `.zst`/`.zstd` ones included.
        metadata: `metadata.yaml`, None if there is none.
        per_message: Each message is compressed by itself (zstd).
        notes: What is missing.
        plan_sha256: SHA-256 of the plan that was measured, from the custom data; empty: not known.
    """

    path: Path
    files: tuple[Path, ...]
    metadata: Path | None
    per_message: bool
    notes: tuple[Note, ...]
    plan_sha256: str = ""


def bag_files(path: Path) -> BagFiles:
    """Find the files of a bag.

    Raises:
        RecordingError: There are none, or `metadata.yaml` cannot be used.
    """
    if not path.is_dir():
        return BagFiles(path, (path,), None, per_message=False, notes=())
    metadata = path / METADATA
    if metadata.is_file():
        return _from_metadata(path, metadata)
    try:
        files = [item for item in path.iterdir() if _storage_suffix(item) in BAG_SUFFIXES and item.is_file()]
    except OSError as error:
        raise RecordingError(path, "", error.strerror or str(error), "a readable rosbag2 directory") from None
    if not files:
        raise RecordingError(path, "", "a directory without .mcap or .db3 file", "a rosbag2 directory")
    files.sort(key=_natural)
    note = Note("no_metadata", path.name, f"no metadata.yaml: all {len(files)} storage files of the directory are read")
    return BagFiles(path, tuple(files), None, per_message=False, notes=(note,))


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d{1,18})", path.name)]


def _storage_suffix(path: PurePath) -> str:
    compressed = path.suffix in (".zst", ".zstd")
    return PurePath(path.stem).suffix if compressed else path.suffix


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
        if _storage_suffix(one) not in BAG_SUFFIXES:
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
    if not there:
        raise RecordingError(
            file, "relative_file_paths", f"{quoted(missing[0])}, which does not exist", "the bag's files"
        )
    text = f"{len(missing)} of {len(files)} storage files do not exist: {', '.join(missing[:3])}"
    notes = (Note("missing_file", path.name, text, len(missing)),) if missing else ()
    plan = plan_of_metadata(file, about.get("custom_data"))
    return BagFiles(path, tuple(there), file, per_message=mode == "message", notes=notes, plan_sha256=plan)


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
            if file.suffix in (".zst", ".zstd"):
                yield from self._compressed(file, topics)
            else:
                yield from self._storage(file, file, topics)

    def _compressed(self, file: Path, topics: Collection[str]) -> Iterator[Batch]:
        with tempfile.TemporaryDirectory() as folder:
            plain = Path(folder) / file.stem
            try:
                with plain.open("wb") as target:
                    whole = decompress_file(file, target)
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
        storage: Storage = SqliteStorage(file) if file.suffix == ".db3" else McapStorage(file)
        try:
            for batch in storage.batches(topics):
                yield self._decompressed(batch) if self.bag.per_message else batch
        except RecordingError as error:
            if file is named:
                raise
            raise RecordingError(named, error.place, error.found, error.expected) from None
        self.notes += storage.notes
        for channel in storage.channels.values():
            self.topics.setdefault(channel.topic, channel.type)

    def _decompressed(self, batch: Batch) -> Batch:
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
    return RecordingError(file, channel.topic, f"messages of type {quoted(channel.type)}", expected)
