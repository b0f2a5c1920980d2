"""The files of a bag: a directory with or without `metadata.yaml`, split or not, compressed or not, or a bare file."""

from __future__ import annotations

import dataclasses
import re
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import yaml

from calibration_core.cell import too_deep
from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.batch import Batch, Channel, Storage
from calibration_core.recording.compression import decompress_file, decompress_message
from calibration_core.recording.mcap import McapStorage
from calibration_core.recording.plan_hash import plan_of_metadata
from calibration_core.recording.source import BAG_SUFFIXES
from calibration_core.recording.sqlite import SqliteStorage
from calibration_core.timeseries import Note

MAX_METADATA = 1 << 20
MAX_FILES = 10_000
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


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
    metadata = path / "metadata.yaml"
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


def _from_metadata(path: Path, metadata: Path) -> BagFiles:
    information = _metadata(metadata)
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
        raise RecordingError(metadata, "relative_file_paths", quoted(names), "a list of file names")
    if len(names) > MAX_FILES:
        raise RecordingError(metadata, "relative_file_paths", f"{len(names)} files", f"at most {MAX_FILES}")
    files = [path / PurePath(name).name for name in names]
    for file in files:
        if _storage_suffix(file) not in BAG_SUFFIXES:
            raise RecordingError(metadata, "relative_file_paths", quoted(file.name), ".mcap or .db3 files")
    mode = str(information.get("compression_mode") or "none").lower()
    form = str(information.get("compression_format") or "").lower()
    if mode not in ("none", "file", "message"):
        raise RecordingError(metadata, "compression_mode", quoted(mode), "one of NONE, FILE, MESSAGE")
    if mode != "none" and form != "zstd":
        raise RecordingError(metadata, "compression_format", quoted(form), "zstd")
    there = [file for file in files if file.is_file()]
    if not there:
        raise RecordingError(
            metadata, "relative_file_paths", f"{files[0].name}, which does not exist", "the bag's files"
        )
    missing = [file.name for file in files if file not in there]
    text = f"{len(missing)} of {len(files)} storage files do not exist: {', '.join(missing[:3])}"
    notes = (Note("missing_file", path.name, text, len(missing)),) if missing else ()
    plan = plan_of_metadata(metadata, information.get("custom_data"))
    return BagFiles(path, tuple(there), metadata, per_message=mode == "message", notes=notes, plan_sha256=plan)


def _metadata(file: Path) -> dict[str, Any]:
    try:
        size = file.stat().st_size
        if size > MAX_METADATA:
            raise RecordingError(file, "", f"{size} bytes", f"at most {MAX_METADATA}")
        text = file.read_text("utf-8")
        if too_deep(text):
            raise RecordingError(file, "", "endless nesting", "metadata as rosbag2 writes it")
        if any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text, Loader=_LOADER)):
            raise RecordingError(file, "", "YAML aliases", "metadata as rosbag2 writes it")
        data = yaml.load(text, Loader=_LOADER)
    except OSError as error:
        raise RecordingError(file, "", error.strerror or str(error), "a readable file") from None
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}" if mark is not None else ""
        raise RecordingError(file, place, "no YAML", "metadata as rosbag2 writes it") from None
    information = data.get("rosbag2_bagfile_information") if isinstance(data, dict) else None
    if not isinstance(information, dict):
        raise RecordingError(file, "rosbag2_bagfile_information", "nothing", "metadata as rosbag2 writes it")
    return information


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
