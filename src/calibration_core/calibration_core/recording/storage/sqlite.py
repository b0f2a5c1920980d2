"""rosbag2's sqlite3 files (.db3): messages as blobs in a table, joined into one buffer by sqlite itself."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.storage.batch import Batch, Channel
from calibration_core.recording.storage.compression import MAX_MESSAGE
from calibration_core.recording.storage.sqlite_pages import is_cut, message_rows
from calibration_core.timeseries import Int1D, Note

MAGIC = b"SQLite format 3\x00"
ROWS = 8192  # messages of all topics per block
MAX_VALUE = 64 << 20
MAX_BLOCK = 64 << 20  # bytes of messages that are held at a time
MAX_TOPICS = 10_000
COLUMNS = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"id", "topic_id", "timestamp", "data"},
    "message_definitions": {"topic_type", "encoding", "encoded_message_definition"},
}
DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
TOPICS = "SELECT id, name, type, serialization_format FROM topics"
BLOCK_END = "SELECT max(id), count(*) FROM (SELECT id FROM messages WHERE id > ? ORDER BY id LIMIT ?)"
SIZES = (
    "SELECT sum(length(data)), max(length(data)), sum(typeof(data) <> 'blob' OR typeof(timestamp) <> 'integer') "
    "FROM messages NOT INDEXED WHERE topic_id = ? AND id > ? AND id <= ?"
)
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
                database.execute("PRAGMA trusted_schema=OFF")
                self._topics(database)
                database.text_factory = bytes  # joined blobs come as text
                yield from self._messages(database, topics)
        except sqlite3.Error as error:
            raise RecordingError(self.path, "", f"an unusable database ({error})", "a rosbag2 sqlite3 file") from None

    def _topics(self, database: sqlite3.Connection) -> None:
        tables = {
            str(name): str(text)
            for name, text in database.execute("SELECT name, sql FROM sqlite_master WHERE type='table' LIMIT 1000")
        }
        if not {"topics", "messages"} <= tables.keys():
            found = "the tables " + ", ".join(sorted(tables)[:8]) if tables else "no tables"
            raise RecordingError(self.path, "", found, "the tables topics and messages of rosbag2")
        for name in COLUMNS.keys() & tables.keys():
            self._require_plain(database, name, tables[name])
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            for kind, form, text in self._texts(database, "message_definitions", DEFINITIONS):
                definitions[kind] = (text, form)
        for key, topic, kind, encoding in self._texts(database, "topics", TOPICS, numbered=True):
            text, form = definitions.get(kind, ("", ""))
            self.channels[int(key)] = Channel(topic, kind, encoding, text, form)

    def _require_plain(self, database: sqlite3.Connection, table: str, text: str) -> None:
        """Refuse a table that is computed while it is read: virtual, or with generated columns.

        Raises:
            RecordingError: It is, or lacks a column.
        """
        place, expected = f"table {table}", "a plain table as rosbag2 makes it"
        if not text.lstrip().upper().startswith("CREATE TABLE"):
            raise RecordingError(self.path, place, quoted(text), expected)
        columns = database.execute(f"PRAGMA table_xinfo({table})").fetchall()
        if any(column[6] != 0 for column in columns):
            raise RecordingError(self.path, place, "generated columns", expected)
        lacking = COLUMNS[table] - {str(column[1]) for column in columns}
        if lacking:
            raise RecordingError(self.path, place, f"no column {min(lacking)}", expected)

    def _texts(
        self, database: sqlite3.Connection, table: str, query: str, *, numbered: bool = False
    ) -> list[tuple[str, ...]]:
        """Return the rows of a small table of texts, the first column a number where `numbered`."""
        rows = database.execute(f"{query} LIMIT {MAX_TOPICS}").fetchall()
        for row in rows:
            if (numbered and not isinstance(row[0], int)) or not all(isinstance(x, str) for x in row[numbered:]):
                raise RecordingError(self.path, f"table {table}", quoted(row), "text as rosbag2 writes it")
        return [tuple(map(str, row)) for row in rows]

    def _messages(self, database: sqlite3.Connection, topics: Collection[str]) -> Iterator[Batch]:
        wanted = [key for key, channel in self.channels.items() if channel.topic in topics]
        last, count, cut, limit = -(1 << 63), 0, is_cut(self.path), ROWS
        while wanted:
            try:
                if cut:
                    msg = "it is shorter than its header says"
                    raise sqlite3.DatabaseError(msg)
                end, rows = database.execute(BLOCK_END, (last, limit)).fetchone()
                if end is None:
                    return
                if sum(self._size(database, key, last, end) for key in wanted) > MAX_BLOCK and rows > 1:
                    limit = max(1, rows // 8)
                    continue
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
            if rows < limit:
                return

    def _size(self, database: sqlite3.Connection, key: int, after: int, last: int) -> int:
        """Return the bytes of one topic's messages with ids in (after, last].

        Raises:
            RecordingError: Some are no blobs, or larger than any message.
        """
        size, longest, wrong = database.execute(SIZES, (key, after, last)).fetchone()
        if wrong:
            raise self._no_messages()
        if longest is not None and longest > MAX_MESSAGE:
            place, expected = self.channels[key].topic, f"messages of at most {MAX_MESSAGE} bytes"
            raise RecordingError(self.path, place, f"a message of {longest} bytes", expected)
        return size or 0

    def _block(self, database: sqlite3.Connection, key: int, after: int, last: int) -> Batch | None:
        """Messages of one topic with ids in (after, last]: joined by sqlite where all have the same length."""
        bounds = (key, after, last)
        count, shortest, longest, joined, stamps = database.execute(JOINED, bounds).fetchone()
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
            raise self._no_messages() from None
        length = np.fromiter(map(len, blobs), np.int64, len(blobs))
        return Batch(self.channels[key], buffer, np.cumsum(length) - length, length, received)

    def _no_messages(self) -> RecordingError:
        found = "messages that are no blobs with integer time stamps"
        return RecordingError(self.path, "table messages", found, "messages as rosbag2 writes them")

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
