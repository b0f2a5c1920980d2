"""rosbag2's sqlite3 files (.db3): messages as blobs in a table, joined into one buffer by sqlite itself."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from calibration_core.errors import RecordingError
from calibration_core.recording.batch import Batch, Channel
from calibration_core.recording.sqlite_pages import is_cut, message_rows
from calibration_core.timeseries import Int1D, Note

MAGIC = b"SQLite format 3\x00"
ROWS = 8192  # messages of all topics per block
MAX_VALUE = 64 << 20
BLOCK_END = "SELECT max(id), count(*) FROM (SELECT id FROM messages WHERE id > ? ORDER BY id LIMIT ?)"
JOINED = (
    "SELECT count(*), min(length(data)), max(length(data)), group_concat(data, ''), group_concat(timestamp, ',') "
    "FROM messages NOT INDEXED WHERE topic_id = ? AND id > ? AND id <= ?"
)  # blobs pass through group_concat byte by byte where the database's text is UTF-8
ROWWISE = "SELECT timestamp, data FROM messages WHERE topic_id = ? AND id > ? AND id <= ? ORDER BY id"


class SqliteStorage:
    """One sqlite3 storage file.

    Attributes:
        channels: Topic id -> channel, complete after `batches`.
        notes: What was lost, complete after `batches`.
    """

    def __init__(self, path: Path) -> None:
        """Remember the path; nothing is opened before `batches`."""
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.notes: list[Note] = []

    def batches(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages on the given topics in the order they were written.

        A write-ahead log that a killed recorder left beside the file is honoured, on a copy: the recording itself is
        never written to.

        Raises:
            RecordingError: The file cannot be read or is no rosbag2 database.
        """
        try:
            with self.path.open("rb") as stream:
                head = stream.read(len(MAGIC))
        except OSError as error:
            raise RecordingError(self.path, "", error.strerror or str(error), "a readable file") from None
        if head != MAGIC:
            raise RecordingError(self.path, "", "another kind of file" if head else "an empty file", "a sqlite3 file")
        log = self.path.with_name(self.path.name + "-wal")
        if not (log.is_file() and log.stat().st_size > 0):
            yield from self._read(self.path, topics, immutable=True)
            return
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / "bag.db3"
            shutil.copyfile(self.path, copy)
            shutil.copyfile(log, Path(folder) / "bag.db3-wal")
            yield from self._read(copy, topics, immutable=False)

    def _read(self, path: Path, topics: Collection[str], *, immutable: bool) -> Iterator[Batch]:
        uri = f"{path.resolve().as_uri()}?mode=ro" + ("&immutable=1" if immutable else "")
        try:
            with closing(sqlite3.connect(uri, uri=True)) as database:
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE)
                # Without this sqlite refuses a file that is shorter than its header says, whole pages included.
                database.execute("PRAGMA writable_schema=ON")
                self._topics(database)
                database.text_factory = bytes  # joined blobs come as text
                yield from self._messages(database, topics)
        except sqlite3.Error as error:
            raise RecordingError(self.path, "", f"an unusable database ({error})", "a rosbag2 sqlite3 file") from None

    def _topics(self, database: sqlite3.Connection) -> None:
        definitions: dict[str, tuple[str, str]] = {}
        tables = {str(name) for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type='table'")}
        if not {"topics", "messages"} <= tables:
            found = "the tables " + ", ".join(sorted(tables)[:8]) if tables else "no tables"
            raise RecordingError(self.path, "", found, "the tables topics and messages of rosbag2")
        if "message_definitions" in tables:
            for kind, form, text in database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            ):
                definitions[str(kind)] = (str(text), str(form))
        for key, topic, kind, encoding in database.execute("SELECT id, name, type, serialization_format FROM topics"):
            text, form = definitions.get(str(kind), ("", ""))
            self.channels[int(key)] = Channel(str(topic), str(kind), str(encoding), text, form)

    def _messages(self, database: sqlite3.Connection, topics: Collection[str]) -> Iterator[Batch]:
        wanted = [key for key, channel in self.channels.items() if channel.topic in topics]
        last, count, cut = -(1 << 63), 0, is_cut(self.path)
        while wanted:
            try:
                if cut:
                    msg = "it is shorter than its header says"
                    raise sqlite3.DatabaseError(msg)
                end, rows = database.execute(BLOCK_END, (last, ROWS)).fetchone()
                if end is None:
                    return
                batches = [batch for key in wanted if (batch := self._block(database, key, last, end)) is not None]
            except sqlite3.DatabaseError as error:
                for batch in self._from_pages(wanted, last):
                    count += len(batch)
                    yield batch
                text = f"the database is damaged ({error}): {count} messages on its whole pages were read"
                self.notes.append(Note("truncated", self.path.name, text))
                return
            count += sum(map(len, batches))
            last = end
            yield from batches
            if rows < ROWS:
                return

    def _block(self, database: sqlite3.Connection, key: int, after: int, last: int) -> Batch | None:
        """Messages of one topic with ids in (after, last]: joined by sqlite where all have the same length."""
        bounds = (key, after, last)
        try:
            count, shortest, longest, joined, stamps = database.execute(JOINED, bounds).fetchone()
        except sqlite3.DataError:  # longer than sqlite's limit for one value
            return self._batch(key, database.execute(ROWWISE, bounds).fetchall())
        if count == 0:
            return None
        received = _times(stamps)
        if shortest == longest and len(joined or b"") == count * longest and len(received) == count:
            start = np.arange(count, dtype=np.int64) * longest
            length = np.full(count, longest, np.int64)
            return Batch(self.channels[key], np.frombuffer(joined, np.uint8), start, length, received)
        return self._batch(key, database.execute(ROWWISE, bounds).fetchall())

    def _batch(self, key: int, rows: list[tuple[int, bytes]]) -> Batch:
        stamps, blobs = zip(*rows, strict=True)
        try:
            buffer = np.frombuffer(b"".join(blobs), np.uint8)
            received = np.array(stamps, np.int64)
        except (TypeError, ValueError, OverflowError):
            found = "messages that are no blobs with integer time stamps"
            raise RecordingError(self.path, "table messages", found, "messages as rosbag2 writes them") from None
        length = np.fromiter(map(len, blobs), np.int64, len(blobs))
        return Batch(self.channels[key], buffer, np.cumsum(length) - length, length, received)

    def _from_pages(self, wanted: list[int], after: int) -> Iterator[Batch]:
        """Messages with ids above `after` from the whole pages of a damaged file."""
        rows: dict[int, list[tuple[int, bytes]]] = {key: [] for key in wanted}
        for number, key, time, data in message_rows(self.path):
            if number > after and key in rows:
                rows[key].append((time, data))
                if len(rows[key]) == ROWS:
                    yield self._batch(key, rows[key])
                    rows[key] = []
        for key, some in rows.items():
            if some:
                yield self._batch(key, some)


def _times(joined: bytes | None) -> Int1D:
    """Numbers from text with commas; none if it is anything else."""
    try:
        return np.fromstring((joined or b"").decode("ascii", "replace"), np.int64, sep=",")
    except ValueError:
        return np.empty(0, np.int64)
