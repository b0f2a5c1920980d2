"""Arrays to CDR messages of constant layout, all rows at once; the counterpart of `layout`."""

from __future__ import annotations

import struct

import numpy as np

from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.layout import LITTLE_ENDIAN
from calibration_core.timeseries import NANOSECONDS, Float2D, TimeSeries


def encode(kind: StreamKind, series: TimeSeries, joints: tuple[str, ...], efforts: Float2D | None) -> list[memoryview]:
    """Serialise a series, one message per sample, with the series' time as stamp.

    Args:
        kind: What the messages are.
        series: (n, k) values.
        joints: For joint states: names of the k joints.
        efforts: For joint states: (n, k) N*m, None leaves them out.

    Returns:
        n messages in little-endian CDR with their encapsulation header.
    """
    head = bytearray(LITTLE_ENDIAN + bytes(8) + _text(series.frame))
    blocks: list[tuple[int, Float2D]] = []
    if kind is StreamKind.JOINTS:
        _align(head, 4)
        head += struct.pack("<I", len(joints))
        for name in joints:
            _align(head, 4)
            head += _text(name)
        for values in (series.values, None, efforts):  # positions, velocities, efforts
            _align(head, 4)
            head += struct.pack("<I", 0 if values is None else values.shape[1])
            if values is not None:
                _doubles(head, blocks, values)
    else:
        values = series.values
        if kind is StreamKind.TEMPERATURE:
            values = np.column_stack([values, np.zeros(len(values))])  # variance unknown
        _doubles(head, blocks, values)
    rows = np.tile(np.frombuffer(bytes(head), np.uint8), (len(series), 1))
    seconds, nanoseconds = np.divmod(series.time, NANOSECONDS)
    rows[:, 4:8] = seconds.astype("<i4").view(np.uint8).reshape(-1, 4)
    rows[:, 8:12] = nanoseconds.astype("<u4").view(np.uint8).reshape(-1, 4)
    for begin, values in blocks:
        data = np.ascontiguousarray(values, "<f8").view(np.uint8).reshape(len(values), -1)
        rows[:, begin : begin + data.shape[1]] = data
    whole, length = memoryview(rows.tobytes()), rows.shape[1]
    return [whole[at : at + length] for at in range(0, len(whole), length)]


def _text(text: str) -> bytes:
    raw = text.encode() + b"\x00"
    return struct.pack("<I", len(raw)) + raw


def _align(head: bytearray, size: int) -> None:
    head += bytes(-(len(head) - 4) % size)


def _doubles(head: bytearray, blocks: list[tuple[int, Float2D]], values: Float2D) -> None:
    if values.shape[1]:
        _align(head, 8)
    blocks.append((len(head), values))
    head += bytes(8 * values.shape[1])
