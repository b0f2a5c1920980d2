"""MCAP files, whole or cut off, with or without an index: read once from front to back.

Only the data section is read; the summary repeats what it says.  So a file that was never closed needs no repair.
Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection, Generator, Iterator
from io import BufferedReader
from pathlib import Path

import numpy as np

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.storage.batch import Batch, Bytes, Channel, as_time, unaligned
from calibration_core.recording.storage.compression import MAX_CHUNK, budget, decompress
from calibration_core.recording.storage.records import MESSAGE, MESSAGE_HEADER, RECORD_HEADER, message_records
from calibration_core.timeseries import Int1D, Note

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, CHUNK, DATA_END, FOOTER = 0x03, 0x04, 0x06, 0x0F, 0x02
COMPRESSIONS = ("", "zstd", "lz4")
MAX_DEFINITION = 1 << 20
MAX_OTHER_RECORDS = 1_000_000
BLOCK = 4 << 20
_CHUNK_HEADER = 32  # start, end, size (8 each), crc, length of the compression's name (4 each)


class McapStorage:
    """One MCAP file.

    Attributes:
        channels: Channel id -> channel, complete after `batches`.
        notes: What was lost, complete after `batches`.
    """

    def __init__(self, path: Path) -> None:
        """Remember the path; nothing is opened before `batches`."""
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.notes: list[Note] = []
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._messages = 0
        self._passed = 0  # bytes of messages that nobody asked for
        self._buffer: Bytes = np.empty(BLOCK, np.uint8)
        self._others = 0

    def batches(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages on the given topics, chunk by chunk; the buffer is reused.

        Raises:
            RecordingError: The file cannot be read, is no MCAP file, or is compressed in an unknown way.
        """
        try:
            with self.path.open("rb") as stream:
                size = stream.seek(0, 2)
                stream.seek(0)
                if stream.read(len(MAGIC)) != MAGIC:
                    found = "an empty file" if size == 0 else "another kind of file"
                    raise RecordingError(self.path, "", found, "an MCAP file")
                yield from self._data_section(stream, size, topics)
        except OSError as error:
            raise RecordingError(self.path, "", error.strerror or str(error), "a readable MCAP file") from None

    def _data_section(self, stream: BufferedReader, size: int, topics: Collection[str]) -> Iterator[Batch]:
        position = len(MAGIC)
        allowance = budget(size)
        while True:
            stream.seek(position)
            size = max(size, position)  # a file that is being written has grown since
            header = stream.read(min(RECORD_HEADER, size - position))
            opcode = header[0] if header else 0
            if opcode in (DATA_END, FOOTER):
                return
            length = int.from_bytes(header[1:], "little")
            whole = len(header) == RECORD_HEADER and opcode != 0 and position + RECORD_HEADER + length <= size
            if opcode == MESSAGE:
                end = yield from self._loose_messages(stream, position, topics)
                if end > position:
                    position = end
                    continue
            if not whole:
                if opcode == CHUNK:
                    yield from self._chunk(stream, min(length, size - position - RECORD_HEADER), topics, partial=True)
                self._lost(position, size)
                return
            if opcode == CHUNK:
                passed = self._passed
                allowance -= yield from self._chunk(stream, length, topics, partial=False)
                allowance += self._passed - passed
                if allowance < 0:
                    raise RecordingError(
                        self.path, f"byte {position}", "chunks that decompress to far more than they can hold",
                        f"at most {budget(size)} bytes in all",
                    )  # fmt: skip
            elif opcode in (SCHEMA, CHANNEL) and length <= MAX_DEFINITION:
                self._define(opcode, stream.read(length))
            else:
                self._others += 1
                if self._others > MAX_OTHER_RECORDS:
                    raise RecordingError(self.path, f"byte {position}", "endless records of no use", "messages")
            position += RECORD_HEADER + length

    def _lost(self, position: int, size: int) -> None:
        text = (
            f"cut off at byte {position} of {size}: what follows is lost ({size - position} bytes); "
            f"{self._messages} messages before it were read"
        )
        self.notes.append(Note("truncated", self.path.name, text))

    def _loose_messages(
        self, stream: BufferedReader, position: int, topics: Collection[str]
    ) -> Generator[Batch, None, int]:
        """Messages that stand outside chunks; the generator's value is where they end."""
        size = BLOCK
        while True:
            stream.seek(position)
            buffer = self._room(size)
            buffer = buffer[: stream.readinto(buffer.data)]
            offsets, end = message_records(buffer, 0)
            if len(offsets) or len(buffer) < size or size >= MAX_CHUNK:
                break
            size *= 2  # one message larger than the block
        yield from self._by_channel(buffer, offsets, topics)
        return position + end

    def _chunk(
        self, stream: BufferedReader, length: int, topics: Collection[str], *, partial: bool
    ) -> Generator[Batch, None, int]:
        """One chunk; the generator's value is the number of bytes it was decompressed to."""
        place = f"{self.path.name}, byte {stream.seek(0, os.SEEK_CUR) - RECORD_HEADER}"
        head = stream.read(min(length, _CHUNK_HEADER))
        if len(head) < _CHUNK_HEADER:
            return 0
        _, _, size, crc, name_length = struct.unpack("<QQQII", head)
        rest = length - _CHUNK_HEADER - name_length - 8
        if name_length > 16 or rest < 0:
            self._damaged(place, "its header makes no sense")
            return 0
        compression = stream.read(name_length).decode("ascii", "replace")
        stored = int.from_bytes(stream.read(8), "little")
        if compression not in COMPRESSIONS:
            choices = "one of none, zstd, lz4"
            raise RecordingError(self.path, place, f"compression {quoted(compression)}", choices)
        if size > MAX_CHUNK or (stored > rest and not partial):
            self._damaged(place, f"it claims {size} bytes stored in {stored}")
            return 0
        try:
            buffer = self._content(stream, compression, size, min(stored, rest), partial=partial)
        except ValueError as error:
            self._damaged(place, str(error))
            return 0
        if crc and not partial and zlib.crc32(buffer.data) != crc:
            self._damaged(place, "its checksum is wrong")
            return len(buffer)
        yield from self._records(buffer, topics, place, partial=partial)
        return len(buffer)

    def _content(self, stream: BufferedReader, compression: str, size: int, stored: int, *, partial: bool) -> Bytes:
        if compression:
            if stored > MAX_CHUNK:
                msg = f"{stored} bytes of compressed data"
                raise ValueError(msg)
            data = stream.read(stored)
            return np.frombuffer(decompress(data, compression, size, partial=partial), np.uint8)
        if stored != size and not partial:
            msg = f"{stored} bytes where the chunk claims {size}"
            raise ValueError(msg)
        buffer = self._room(min(stored, size))
        return buffer[: stream.readinto(buffer.data)]

    def _room(self, size: int) -> Bytes:
        if size > len(self._buffer):
            self._buffer = np.empty(size, np.uint8)
        return self._buffer[:size]

    def _damaged(self, place: str, why: str) -> None:
        self.notes.append(Note("damaged", place, f"a chunk cannot be used: {why}"))

    def _records(self, buffer: Bytes, topics: Collection[str], place: str, *, partial: bool) -> Iterator[Batch]:
        position = 0
        while position + RECORD_HEADER <= len(buffer):
            offsets, end = message_records(buffer, position)
            if len(offsets):
                yield from self._by_channel(buffer, offsets, topics)
                position = end
                continue
            opcode = int(buffer[position])
            length = int.from_bytes(buffer[position + 1 : position + RECORD_HEADER].tobytes(), "little")
            end = position + RECORD_HEADER + length
            self._others += 1
            if end > len(buffer) or opcode == 0 or self._others > MAX_OTHER_RECORDS:
                break
            if opcode in (SCHEMA, CHANNEL) and length <= MAX_DEFINITION:
                self._define(opcode, buffer[position + RECORD_HEADER : end].tobytes())
            position = end
        if position != len(buffer) and not partial:
            self._damaged(place, f"no record at byte {position} of its {len(buffer)}")

    def _by_channel(self, buffer: Bytes, offsets: Int1D, topics: Collection[str]) -> Iterator[Batch]:
        if not len(offsets):
            return
        self._messages += len(offsets)
        ids = unaligned(buffer, "<u2")[offsets + RECORD_HEADER]
        present = np.flatnonzero(np.bincount(ids))
        for key in present:
            channel = self.channels.get(int(key))
            rows = offsets if len(present) == 1 else offsets[ids == key]
            if channel is None or channel.topic not in topics:
                self._passed += int(unaligned(buffer, "<u8")[rows + 1].sum())
                continue
            lengths = unaligned(buffer, "<u8")[rows + 1].astype(np.int64) - MESSAGE_HEADER
            received = as_time(unaligned(buffer, "<u8")[rows + RECORD_HEADER + 6])
            yield Batch(channel, buffer, rows + RECORD_HEADER + MESSAGE_HEADER, lengths, received)

    def _define(self, opcode: int, content: bytes) -> None:
        try:
            if opcode == SCHEMA:
                (key,), at = struct.unpack_from("<H", content), 2
                fields = []
                for _ in range(3):
                    text, at = _text(content, at)
                    fields.append(text)
                self._schemas[key] = (fields[0], fields[1], fields[2])
                return
            (key, schema), at = struct.unpack_from("<HH", content), 4
            topic, at = _text(content, at)
            encoding, _ = _text(content, at)
        except (struct.error, UnicodeDecodeError, ValueError):
            self.notes.append(Note("damaged", self.path.name, "a record that declares a topic cannot be read"))
            return
        kind, form, text = self._schemas.get(schema, ("", "", ""))
        self.channels[key] = Channel(topic, kind, encoding, text, form)


def _text(content: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", content, at)
    end = at + 4 + length
    if end > len(content):
        msg = "text beyond the end of its record"
        raise ValueError(msg)
    return content[at + 4 : end].decode("utf-8"), end
