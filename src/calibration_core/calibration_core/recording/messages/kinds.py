"""The messages this software understands: what is taken from each, and where it lies when the layout is fixed."""

from __future__ import annotations

import dataclasses
import enum

import numpy as np

from calibration_core.timeseries import Float2D, Int1D


class StreamKind(enum.Enum):
    """A stream of samples; the value is its message type."""

    JOINTS = "sensor_msgs/msg/JointState"
    POINT = "geometry_msgs/msg/PointStamped"
    WRENCH = "geometry_msgs/msg/WrenchStamped"
    TEMPERATURE = "sensor_msgs/msg/Temperature"

    @property
    def numbers(self) -> int:
        """How many float64 follow the header (in their order), for the kinds that always have the same number."""
        return {StreamKind.POINT: 3, StreamKind.WRENCH: 6, StreamKind.TEMPERATURE: 2}[self]

    @property
    def columns(self) -> int:
        """How many of them are kept: the variance of a temperature is not."""
        return {StreamKind.POINT: 3, StreamKind.WRENCH: 6, StreamKind.TEMPERATURE: 1}[self]


@dataclasses.dataclass(frozen=True, eq=False)
class Samples:
    """Decoded messages of one topic, in file order.

    Attributes:
        order: (n,) place of each message in its batch (in the file, once joined).
        stamp: (n,) `header.stamp` in ns, 0 where it is missing.
        received: (n,) receive time, ns.
        values: (n, k) float64; for joint states the positions in the order asked for.
        efforts: (n, k) float64 for joint states, NaN where a message has none; else None.
        frames: `frame_id` -> number of messages.
        malformed: Messages that could not be read.
        unusable: Joint states without a position for every joint.
        example: Joint names of one such message.
    """

    order: Int1D
    stamp: Int1D
    received: Int1D
    values: Float2D
    efforts: Float2D | None = None
    frames: dict[str, int] = dataclasses.field(default_factory=dict)
    malformed: int = 0
    unusable: int = 0
    example: tuple[str, ...] = ()


def join(parts: list[Samples], columns: int, *, efforts: bool, sort: bool = False) -> Samples:
    """Join samples.

    Args:
        parts: What to join; with none, the result has no samples.
        columns: Number of columns of the values.
        efforts: Whether there are efforts.
        sort: The parts are of one batch: bring the messages into its order.  Otherwise they are joined as they stand.
    """
    frames: dict[str, int] = {}
    for part in parts:
        for frame, count in part.frames.items():
            frames[frame] = frames.get(frame, 0) + count
    full = [part for part in parts if len(part.stamp)]
    none, empty = [np.empty(0, np.int64)] * (not full), [np.empty((0, columns))] * (not full)
    order = np.concatenate([part.order for part in full] or none)
    arrays = {
        "stamp": np.concatenate([part.stamp for part in full] or none),
        "received": np.concatenate([part.received for part in full] or none),
        "values": np.concatenate([part.values for part in full] or empty),
    }
    if efforts:
        arrays["efforts"] = np.concatenate([part.efforts for part in full if part.efforts is not None] or empty)
    if sort:
        rank = np.argsort(order, kind="stable")
        order = order[rank]
        arrays = {name: array[rank] for name, array in arrays.items()}
    else:
        order = np.arange(len(order))
    return Samples(
        order=order,
        frames=frames,
        malformed=sum(part.malformed for part in parts),
        unusable=sum(part.unusable for part in parts),
        example=next((part.example for part in parts if part.example), ()),
        **arrays,
    )
