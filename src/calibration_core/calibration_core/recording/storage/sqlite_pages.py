"""Messages from the pages of a damaged sqlite3 file, without its tree.

When a database is cut off, its inner pages may be lost though most messages are there.  Each leaf page describes
itself, so whole pages are read one by one and every row that looks like a message of rosbag2 is taken: an id that is
the row's number, two integers (topic, receive time) and a blob.  Format: https://sqlite.org/fileformat2.html.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

LEAF = 0x0D
INTEGER_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
MAX_ROW = 64 << 20


def page_size(header: bytes) -> int:
    """Page size in bytes from the first 100 bytes of a file; 0 if it is none that sqlite allows."""
    (size,) = struct.unpack_from(">H", header, 16)
    size = 65536 if size == 1 else size
    return size if size >= 512 and size & (size - 1) == 0 else 0


def is_cut(path: Path) -> bool:
    """Tell whether a database file is shorter than its header says."""
    with path.open("rb") as stream:
        header = stream.read(100)
        size = stream.seek(0, 2)
    if len(header) < 100:
        return True
    counter, pages, valid_for = (struct.unpack_from(">I", header, at)[0] for at in (24, 28, 92))
    return counter == valid_for and size < pages * page_size(header)


def message_rows(path: Path) -> Iterator[tuple[int, int, int, bytes]]:
    """Yield (id, topic, receive time, data) of the messages on the whole pages of a file, page by page."""
    with path.open("rb") as stream:
        header = stream.read(100)
        size = page_size(header) if len(header) == 100 else 0
        if not size:
            return
        pages = _Pages(stream, size, size - header[20])
        for number in range(pages.count):
            page = pages.read(number)
            begin = 100 if number == 0 else 0
            if page[begin] != LEAF:
                continue
            (cells,) = struct.unpack_from(">H", page, begin + 3)
            if begin + 8 + 2 * cells > size:
                continue
            for (at,) in struct.iter_unpack(">H", page[begin + 8 : begin + 8 + 2 * cells]):
                row = _row(pages, page, at)
                if row is not None:
                    yield row


class _Pages:
    def __init__(self, stream: BufferedReader, size: int, usable: int) -> None:
        self.stream, self.size, self.usable = stream, size, usable
        self.count = stream.seek(0, 2) // size

    def read(self, number: int) -> bytes:
        self.stream.seek(number * self.size)
        return self.stream.read(self.size)

    def payload(self, page: bytes, at: int, length: int) -> bytes | None:
        """Content of a cell, followed through its overflow pages; None if those are not all there."""
        most = self.usable - 35
        if length <= most:
            return page[at : at + length] if at + length <= self.usable else None
        least = (self.usable - 12) * 32 // 255 - 23
        local = least + (length - least) % (self.usable - 4)
        local = local if local <= most else least
        if length > MAX_ROW or at + local + 4 > self.usable:
            return None
        parts = [page[at : at + local]]
        (following,) = struct.unpack_from(">I", page, at + local)
        missing = length - local
        while missing > 0:
            if not 0 < following <= self.count:
                return None
            overflow = self.read(following - 1)
            parts.append(overflow[4 : 4 + min(missing, self.usable - 4)])
            missing -= len(parts[-1])
            (following,) = struct.unpack_from(">I", overflow, 0)
        return b"".join(parts)


def _row(pages: _Pages, page: bytes, at: int) -> tuple[int, int, int, bytes] | None:
    try:
        length, at = _varint(page, at)
        row, at = _varint(page, at)
        content = pages.payload(page, at, length)
        if content is None:
            return None
        end, at = _varint(content, 0)
        kinds = []
        while at < end:
            kind, at = _varint(content, at)
            kinds.append(kind)
    except IndexError:
        return None
    if len(kinds) != 4 or kinds[0] != 0 or not set(kinds[1:3]) <= INTEGER_BYTES.keys() or kinds[3] < 12 or kinds[3] % 2:
        return None
    numbers = []
    for kind in kinds[1:3]:
        width = INTEGER_BYTES[kind]
        numbers.append(int.from_bytes(content[at : at + width], "big", signed=True) if width else kind - 8)
        at += width
    data = content[at:]
    return (row, numbers[0], numbers[1], data) if len(data) == (kinds[3] - 12) // 2 else None


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Read sqlite's variable-length integer: up to eight bytes of seven bits, big end first, a ninth of eight."""
    value = 0
    for i in range(8):
        byte = data[at + i]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + i + 1
    return value << 8 | data[at + 8], at + 9
