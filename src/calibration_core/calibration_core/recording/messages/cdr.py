"""Messages by their definition, field by field.

Half as fast as generated code, but nothing is generated: a definition from a bag is data.  CDR (OMG
formal/02-06-51) aligns a number of n bytes to n, counted from behind the encapsulation header of 4 bytes.
"""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import numpy as np

from calibration_core.recording.definitions.fields import SIZES, TEXT, Types

CODES = {
    "bool": "?", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "float32": "f", "int64": "q", "uint64": "Q", "float64": "d",
}  # fmt: skip
MAX_VALUES = 100_000  # of one message, arrays of numbers counted once
ENCAPSULATIONS = {b"\x00\x00": ">", b"\x00\x01": "<"}


def read_message(payload: bytes, types: Types, name: str) -> Any:
    """Return a message as an object with the fields as attributes; arrays of numbers are numpy arrays.

    Args:
        payload: The message with its encapsulation header.
        types: Fields of its type and of all in it.
        name: Its type.

    Raises:
        ValueError: It is not a message of this type.
    """
    order = ENCAPSULATIONS.get(payload[:2])
    if order is None or len(payload) < 4:
        msg = "no plain CDR"
        raise ValueError(msg)
    cursor = _Cursor(payload, order, types)
    message = cursor.message(name)
    if cursor.at + 3 < len(payload):  # more than the padding that writers append
        msg = f"{len(payload) - cursor.at} bytes more than its fields"
        raise ValueError(msg)
    return message


class _Cursor:
    def __init__(self, payload: bytes, order: str, types: Types) -> None:
        self.payload, self.order, self.types = payload, order, types
        self.at = 4
        self._values = 0

    def message(self, name: str) -> SimpleNamespace:
        fields = self.types[name]
        if not fields:
            self._take(1, 1)  # an empty type has one byte
            return SimpleNamespace()
        found: dict[str, Any] = {}
        for field in fields:
            if field.shape == "one":
                found[field.name] = self._one(field.type)
            else:
                count = field.size if field.shape == "array" else int(self._number("uint32"))
                found[field.name] = self._many(field.type, count)
        return SimpleNamespace(**found)

    def _one(self, kind: str) -> Any:
        self._values += 1
        if self._values > MAX_VALUES:
            msg = f"more than {MAX_VALUES} values"
            raise ValueError(msg)
        if kind in SIZES:
            return self._number(kind)
        return self._text() if kind == TEXT else self.message(kind)

    def _many(self, kind: str, count: int) -> Any:
        if count > len(self.payload) - self.at:  # every value takes a byte at least
            msg = f"{count} values beyond the end"
            raise ValueError(msg)
        if kind not in SIZES:
            return [self._one(kind) for _ in range(count)]
        if not count:
            return np.empty(0, CODES[kind])
        begin = self._take(SIZES[kind], count)
        return np.frombuffer(self.payload, f"{self.order}{CODES[kind]}", count, begin)

    def _number(self, kind: str) -> Any:
        size = SIZES[kind]
        return struct.unpack_from(f"{self.order}{CODES[kind]}", self.payload, self._take(size, 1))[0]

    def _text(self) -> str:
        length = int(self._number("uint32"))
        begin = self._take(1, length)
        return self.payload[begin : begin + length].removesuffix(b"\x00").decode("utf-8")

    def _take(self, size: int, count: int) -> int:
        """Step over aligned values and return where they begin."""
        begin = 4 + (self.at - 4 + size - 1) // size * size
        self.at = begin + size * count
        if self.at > len(self.payload):
            msg = "shorter than its fields"
            raise ValueError(msg)
        return begin
