"""The walk over MCAP message records without Python per message.

A record is one byte of opcode, eight bytes of length and the content; message records have opcode 5 and 22 bytes of
channel, sequence number, log time and publish time before the payload (MCAP specification, "Message").  Records
follow each other without gaps, so each offset must be the end of the record before: that is proved here for every
record with array operations.
"""

from __future__ import annotations

import numpy as np

from calibration_core.recording.storage.batch import Bytes, unaligned
from calibration_core.timeseries import Int1D

MESSAGE = 0x05
RECORD_HEADER = 9
MESSAGE_HEADER = 22
SHORTEST_RUN = 32
_LONGEST = 1 << 40


def message_records(buffer: Bytes, start: int) -> tuple[Int1D, int]:
    """Find the unbroken run of whole message records that begins at `start`.

    Args:
        buffer: (bytes,) uint8.
        start: Offset of a record.

    Returns:
        Offsets of the records, (n,) int64, and the offset behind the last one: the end of the buffer, a record of
        another kind, or one that is not whole.
    """
    found: list[Int1D] = []
    position = start
    while True:
        offsets, end = _equal_records(buffer, position)
        if len(offsets) < SHORTEST_RUN and end < len(buffer):
            offsets, end = _any_records(buffer, position)
        if not len(offsets):
            break
        found.append(offsets)
        position = end
    return (np.concatenate(found) if len(found) != 1 else found[0]) if found else np.empty(0, np.int64), position


def _equal_records(buffer: Bytes, start: int) -> tuple[Int1D, int]:
    """Records as long as the first one: one topic with messages of constant size."""
    size = len(buffer)
    if start + RECORD_HEADER + MESSAGE_HEADER > size or buffer[start] != MESSAGE:
        return np.empty(0, np.int64), start
    length = int(buffer[start + 1 : start + RECORD_HEADER].view("<u8")[0])
    stride = RECORD_HEADER + length
    count = (size - start) // stride
    if length < MESSAGE_HEADER or count == 0:
        return np.empty(0, np.int64), start
    opcodes = buffer[start : start + (count - 1) * stride + 1 : stride]
    lengths = np.ndarray((count,), np.dtype("<u8"), buffer=buffer, offset=start + 1, strides=(stride,))
    same = (opcodes == MESSAGE) & (lengths == length)
    run = count if same.all() else int(np.argmin(same))
    return start + stride * np.arange(run, dtype=np.int64), start + run * stride


def _any_records(buffer: Bytes, start: int) -> tuple[Int1D, int]:
    """Records of any length: every byte 5 that could begin a record is a candidate, and the chain decides."""
    size = len(buffer)
    candidates = (
        np.flatnonzero(buffer[start : max(start, size - RECORD_HEADER - MESSAGE_HEADER + 1)] == MESSAGE) + start
    )
    lengths = unaligned(buffer, "<u8")[candidates + 1]
    possible = (lengths >= MESSAGE_HEADER) & (lengths < _LONGEST)
    candidates, lengths = candidates[possible], lengths[possible].astype(np.int64)
    ends = candidates + RECORD_HEADER + lengths
    whole = ends <= size
    candidates, ends = candidates[whole], ends[whole]
    if not len(candidates) or candidates[0] != start:
        return np.empty(0, np.int64), start
    breaks = np.flatnonzero(ends[:-1] != candidates[1:])
    breaks = np.append(breaks, len(candidates) - 1)
    runs: list[Int1D] = []
    first = 0
    while True:  # once per candidate that was not a record, not per message
        last = int(breaks[np.searchsorted(breaks, first)])
        runs.append(candidates[first : last + 1])
        end = int(ends[last])
        following = int(np.searchsorted(candidates, end))
        if following == len(candidates) or candidates[following] != end:
            return np.concatenate(runs), end
        first = following
