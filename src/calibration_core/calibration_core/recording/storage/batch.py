"""What the storage formats hand on: channels, and batches of serialised messages that lie in one buffer."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from calibration_core.timeseries import Int1D, Note

Bytes = NDArray[np.uint8]
LATEST = np.iinfo(np.int64).max


@dataclasses.dataclass(frozen=True)
class Channel:
    """One topic as one publisher wrote it.

    Attributes:
        type: Message type, e.g. `geometry_msgs/msg/PointStamped`.
        encoding: Serialisation of the messages; `cdr` is the only one in ROS 2.
        definition: Text of the message definition from the bag, empty if the bag has none.
        definition_format: `ros2msg`, `ros2idl` or empty.
    """

    topic: str
    type: str
    encoding: str = "cdr"
    definition: str = ""
    definition_format: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Serialised messages of one channel, in file order.

    The buffer may be reused for the next batch: whoever needs more than views copies.

    Attributes:
        buffer: (bytes,) uint8, holds the payloads.
        start: (n,) offset of each payload in the buffer.
        length: (n,) bytes of each payload, encapsulation header included.
        received: (n,) receive time, ns.
    """

    channel: Channel
    buffer: Bytes
    start: Int1D
    length: Int1D
    received: Int1D

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.start)

    def payload(self, row: int) -> bytes:
        """Return a copy of one message."""
        return self.buffer[self.start[row] : self.start[row] + self.length[row]].tobytes()


class Storage(Protocol):
    """One storage file.  `channels` and `notes` are complete once `batches` is exhausted."""

    channels: dict[int, Channel]
    notes: list[Note]

    def batches(self, topics: Collection[str]) -> Iterator[Batch]:
        """Yield the messages on the given topics."""
        ...


def unaligned(buffer: Bytes, dtype: str) -> NDArray[Any]:
    """View a little-endian number at every byte offset of the buffer; element i starts at byte i."""
    kind = np.dtype(dtype)
    count = max(0, len(buffer) - kind.itemsize + 1)
    return np.ndarray((count,), kind, buffer=buffer, strides=(1,)) if count else np.empty(0, kind)


def as_time(values: NDArray[np.uint64]) -> Int1D:
    """Convert unsigned ns to int64; what is beyond its range (year 2262) becomes the latest time."""
    return np.minimum(values, np.uint64(LATEST)).astype(np.int64)
