"""Fixed layouts in CDR: where the numbers of a message lie, proved for every row, read without Python per message.

A message whose strings and sequences have constant lengths has its numbers at constant offsets.  A `Layout` is taken
from one message and holds all bytes that fix the offsets: encapsulation, `frame_id`, array sizes, joint names.  A row
belongs to the layout only if its length and all those bytes are the same; padding may hold anything.

CDR (OMG formal/02-06-51) aligns a number of n bytes to n, counted from behind the encapsulation header of 4 bytes.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration_core.recording.messages.kinds import Samples, StreamKind
from calibration_core.recording.storage.batch import Batch, Bytes
from calibration_core.timeseries import NANOSECONDS, Bool1D, Int1D

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
STAMP = struct.Struct("<iI")
_STAMP = 4
_FRAME = 12
MAX_JOINTS = 256
SPARE = 16  # bytes, by which rclpy takes a serialised message for longer than it is: what it may need for alignment


@dataclasses.dataclass(frozen=True, eq=False)
class Layout:
    """Where the numbers lie in messages of one exact shape.

    Attributes:
        length: Bytes of the message, encapsulation header included.
        constants: (offset, type, value) of numbers that cover all bytes which must not differ.
        values: Offset of the first float64, and how many there are.
        pick: Columns to keep, in order.
        efforts: Offset of the first effort, None if there are none.
        frame: `frame_id`.
        usable: Whether the wanted joints are all there.
        names: Joint names.
    """

    length: int
    constants: tuple[tuple[int, str, int], ...]
    values: tuple[int, int]
    pick: tuple[int, ...]
    efforts: int | None
    frame: str
    usable: bool = True
    names: tuple[str, ...] = ()


class _Cursor:
    """Steps through one message and remembers which bytes fix the layout."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.at = 4
        self.fixed: list[tuple[int, int]] = []

    def align(self, size: int) -> None:
        self.at = 4 + (self.at - 4 + size - 1) // size * size

    def fix(self, size: int) -> bytes:
        if self.at + size > len(self.payload):
            msg = "shorter than its layout"
            raise ValueError(msg)
        self.fixed.append((self.at, self.at + size))
        self.at += size
        return self.payload[self.at - size : self.at]

    def count(self) -> int:
        self.align(4)
        return int(struct.unpack("<I", self.fix(4))[0])

    def text(self) -> str:
        raw = self.fix(self.count())
        if not raw or raw[-1] != 0:
            msg = "text without an end"
            raise ValueError(msg)
        return raw[:-1].decode("utf-8")

    def doubles(self, count: int) -> int:
        """Step over float64 numbers and return where they begin."""
        if count:
            self.align(8)
        begin = self.at
        self.at += 8 * count
        if self.at > len(self.payload):
            msg = "shorter than its layout"
            raise ValueError(msg)
        return begin


def layout_of(kind: StreamKind, payload: bytes, joints: tuple[str, ...] = ()) -> Layout | None:
    """Take the layout from one message.

    Returns:
        The layout; None if the message is not plain little-endian CDR of its kind (the typed reader has to decide).
    """
    if payload[:4] != LITTLE_ENDIAN:
        return None
    cursor = _Cursor(payload)
    cursor.fixed.append((0, 4))
    cursor.at = _FRAME
    try:
        frame = cursor.text()
        if kind is not StreamKind.JOINTS:
            begin = cursor.doubles(kind.numbers)
            return _finish(cursor, (begin, kind.numbers), tuple(range(kind.columns)), None, frame)
        count = cursor.count()
        if count > MAX_JOINTS:
            return None
        names = tuple(cursor.text() for _ in range(count))
        positions = cursor.count()
        begin = cursor.doubles(positions)
        cursor.doubles(cursor.count())
        n_efforts = cursor.count()
        efforts = cursor.doubles(n_efforts)
    except (ValueError, struct.error):
        return None
    if positions != count or not set(joints) <= set(names):
        layout = _finish(cursor, (begin, positions), (), None, frame)
        return None if layout is None else dataclasses.replace(layout, usable=False, names=names)
    pick = tuple(names.index(joint) for joint in joints)
    layout = _finish(cursor, (begin, positions), pick, efforts if n_efforts == count else None, frame)
    return None if layout is None else dataclasses.replace(layout, names=names)


def _finish(
    cursor: _Cursor, values: tuple[int, int], pick: tuple[int, ...], efforts: int | None, frame: str
) -> Layout | None:
    if cursor.at + 3 < len(cursor.payload):  # more than the padding that writers append
        return None
    constants: list[tuple[int, str, int]] = []
    for begin, end in cursor.fixed:
        while begin < end:
            size = next(size for size in (8, 4, 2, 1) if begin + size <= end)
            number = int.from_bytes(cursor.payload[begin : begin + size], "little")
            constants.append((begin, f"<u{size}", number))
            begin += size
    return Layout(len(cursor.payload), tuple(constants), values, pick, efforts, frame)


class Mould:
    """Serialises messages of one shape: a first one is kept, and its stamp and numbers are replaced."""

    def __init__(self, kind: StreamKind, payload: bytes) -> None:
        """Take the first one, little-endian CDR of its kind; rclpy leaves bytes that mean nothing behind its end.

        Raises:
            ValueError: It is something else.
        """
        cut = (payload[: len(payload) - spare] for spare in range(0, SPARE + 1, 4))
        layout = next(filter(None, (layout_of(kind, one) for one in cut)), None)
        if layout is None:
            msg = f"no little-endian {kind.value}"
            raise ValueError(msg)
        self._bytes, self._at = bytearray(payload[: layout.length]), layout.values[0]
        self._numbers = struct.Struct(f"<{layout.values[1]}d")

    def cast(self, stamp: int, values: Sequence[float]) -> bytes:
        """Return a message of a stamp, ns, and as many numbers as the first one has: of joint states the positions."""
        STAMP.pack_into(self._bytes, _STAMP, *divmod(stamp, NANOSECONDS))
        self._numbers.pack_into(self._bytes, self._at, *values)
        return bytes(self._bytes)


class MessageRows:
    """Messages of one length as strided views into a buffer."""

    def __init__(self, buffer: Bytes, start: Int1D, length: int) -> None:
        """View the messages in place where they lie equally spaced; gather them otherwise."""
        steps = np.diff(start)
        if len(steps) and (steps != steps[0]).any():
            records = np.ndarray((len(buffer) - length + 1,), np.dtype((np.void, length)), buffer=buffer, strides=(1,))
            self.buffer: Bytes = records[start].view(np.uint8)
            self.first, self.step = 0, length
        else:
            self.buffer, self.first = buffer, int(start[0])
            self.step = int(steps[0]) if len(steps) else length
        self.count = len(start)

    def column(self, offset: int, dtype: str, width: int | None = None) -> NDArray[np.generic]:
        """(n,) or (n, width) view of little-endian numbers at an offset of every message."""
        kind = np.dtype(dtype)
        shape = (self.count,) if width is None else (self.count, width)
        strides = (self.step,) if width is None else (self.step, kind.itemsize)
        return np.ndarray(shape, kind, buffer=self.buffer, offset=self.first + offset, strides=strides)

    def match(self, layout: Layout) -> Bool1D:
        """(n,) whether each message has every byte that fixes the layout."""
        same = np.ones(self.count, np.bool_)
        for offset, dtype, value in layout.constants:
            same &= self.column(offset, dtype) == value
        return same


def stamps(rows: MessageRows) -> Int1D:
    """(n,) `header.stamp` in ns."""
    seconds = rows.column(_STAMP, "<i4").astype(np.int64)
    seconds *= NANOSECONDS
    seconds += rows.column(_STAMP + 4, "<u4").astype(np.int64)
    return seconds


def extract(batch: Batch, index: Int1D, rows: MessageRows, layout: Layout, *, efforts: bool) -> Samples:
    """Read messages that all match the layout.

    Args:
        batch: Where the receive times are.
        index: (n,) rows of the batch that `rows` views.
        rows: The messages.
        layout: Their layout.
        efforts: Whether efforts are wanted (joint states).
    """
    if not layout.usable:
        none = np.empty(0, np.int64)
        empty = np.empty((0, 0))
        return Samples(none, none, none, empty, empty if efforts else None, unusable=rows.count, example=layout.names)
    begin, count = layout.values
    values = _block(rows, begin, count, layout.pick)
    torque = None
    if efforts:
        torque = (
            np.full((rows.count, len(layout.pick)), np.nan)
            if layout.efforts is None
            else _block(rows, layout.efforts, count, layout.pick)
        )
    received = batch.received if len(index) == len(batch) else batch.received[index]
    return Samples(index, stamps(rows), received, values, torque, {layout.frame: rows.count})


def _block(rows: MessageRows, begin: int, count: int, pick: tuple[int, ...]) -> NDArray[np.float64]:
    view = rows.column(begin, "<f8", count)
    plain = pick == tuple(range(len(pick)))
    return np.array(view[:, : len(pick)] if plain else view[:, list(pick)], dtype=np.float64, order="C")
