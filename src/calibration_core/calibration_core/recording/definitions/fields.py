"""The fields of a message type, with bounds on everything and nothing evaluated."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Literal

MAX_TYPES = 64
MAX_ARRAY = 1 << 16
SEPARATOR = re.compile(r"^={80}[ \t]*$", re.MULTILINE)
SIZES = {
    "bool": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
    "float32": 4, "int64": 8, "uint64": 8, "float64": 8,
}  # fmt: skip
TEXT = "string"


@dataclasses.dataclass(frozen=True)
class MessageField:
    """One field of a message type.

    Attributes:
        name: Its name.
        type: A key of `SIZES`, `string`, or the name of a message type.
        shape: One value, a fixed number of them, or a number that the message states.
        size: Number of values of an array.
    """

    name: str
    type: str
    shape: Literal["one", "array", "sequence"] = "one"
    size: int = 1


Types = Mapping[str, tuple[MessageField, ...]]


def array_size(text: str) -> int:
    """Return the size of an array.

    Raises:
        ValueError: It is zero or larger than any real one.
    """
    size = int(text)
    if not 0 < size <= MAX_ARRAY:
        msg = f"an array of {size}"
        raise ValueError(msg)
    return size
