"""The array walk finds the records that a walk step by step finds."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration_core.recording.storage.records import message_records


def record(payload: bytes, opcode: int = 5) -> bytes:
    content = struct.pack("<HIQQ", 1, 0, 7, 7) + payload
    return struct.pack("<BQ", opcode, len(content)) + content


def one_by_one(data: bytes) -> tuple[list[int], int]:
    offsets, at = [], 0
    while at + 31 <= len(data) and data[at] == 5:
        length = struct.unpack_from("<Q", data, at + 1)[0]
        if length < 22 or at + 9 + length > len(data):
            break
        offsets.append(at)
        at += 9 + length
    return offsets, at


def walk(data: bytes) -> tuple[list[int], int]:
    offsets, end = message_records(np.frombuffer(data, np.uint8), 0)
    return offsets.tolist(), end


# Payloads that look like records themselves: a length field that is plausible, within the payload.
decoys = st.builds(
    lambda n, pad: bytes([5]) + struct.pack("<Q", n) + bytes(pad), st.integers(0, 80), st.integers(0, 60)
)
payloads = st.one_of(st.binary(max_size=80), decoys, st.lists(decoys, max_size=4).map(b"".join))


@settings(max_examples=300, deadline=None)
@given(st.lists(payloads, max_size=60), st.integers(0, 40), st.booleans())
def test_any_lengths(contents: list[bytes], cut: int, other: bool) -> None:
    data = b"".join(map(record, contents))
    if other:
        data += record(b"index", opcode=7) + record(b"never reached")
    data = data[: max(0, len(data) - cut)]
    assert walk(data) == one_by_one(data)


@pytest.mark.parametrize("count", [1, 31, 32, 33, 500])
@pytest.mark.parametrize("tail", [b"", b"\x05", record(b"longer than the others"), record(b"x", 7), b"\x00" * 50])
def test_equal_lengths_and_what_follows(count: int, tail: bytes) -> None:
    data = record(b"12345678") * count + tail
    assert walk(data) == one_by_one(data)


def test_changing_lengths_in_blocks() -> None:
    data = b"".join(record(bytes(size)) * 100 for size in (10, 50, 20, 10))
    assert walk(data) == one_by_one(data)
    assert len(walk(data)[0]) == 400


def test_a_record_that_claims_everything() -> None:
    data = record(b"fine") + struct.pack("<BQ", 5, 2**60) + bytes(100)
    assert walk(data) == ([0], len(record(b"fine")))


def test_nothing() -> None:
    assert walk(b"") == ([], 0)
