"""The typed reader: any message that the definitions in the bag describe, one at a time."""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.definitions.fields import Types
from calibration_core.recording.definitions.own import STEP_DEFINITION, STEP_TYPE
from calibration_core.recording.definitions.streams import stream_types
from calibration_core.recording.definitions.text import parse_definition
from calibration_core.recording.messages.cdr import read_message
from calibration_core.recording.messages.kinds import Samples, StreamKind
from calibration_core.recording.storage.batch import Batch, Channel
from calibration_core.timeseries import NANOSECONDS, Int1D

Deserialize = Callable[[bytes], Any]
FAULTS = (struct.error, ValueError, IndexError, TypeError, AttributeError, OverflowError)


@functools.cache
def standard_types() -> Any:
    """Return the types of ROS 2 Jazzy and our own `MeasurementStep`; imported when asked for, because it takes long."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(STEP_DEFINITION, STEP_TYPE))
    return store


@functools.cache
def _bundled(name: str) -> Types:
    """Return the fields of a type as ROS 2 Jazzy has it; none if it has none of this name."""
    if found := stream_types(name):
        return found
    if name not in standard_types().fielddefs:
        return {}
    text, _ = standard_types().generate_msgdef(name, ros_version=2)
    return parse_definition(text, name, "ros2msg")


@functools.lru_cache(maxsize=64)
def _own(channel: Channel) -> Types:
    """Return the fields as the bag defines them.

    Raises:
        ValueError: It defines none, or in no way that can be read.
    """
    if not channel.definition:
        msg = "none in the bag, and none known"
        raise ValueError(msg)
    return parse_definition(channel.definition, channel.type, channel.definition_format, _bundled)


def deserializer(file: str, channel: Channel) -> Deserialize:
    """Return the function that turns a message of the channel into an object.

    It is read field by field, as its definition says: what stands in a bag is never made into code.

    Raises:
        RecordingError: The definition in the bag cannot be read, or the encoding is not CDR.
    """
    if channel.encoding != "cdr":
        raise RecordingError(file, channel.topic, f"messages encoded as {quoted(channel.encoding)}", "cdr")
    try:
        types = _bundled(channel.type) if is_standard(channel) else _own(channel)
    except ValueError as error:
        found = f"a definition of {quoted(channel.type)} that cannot be read ({error})"
        raise RecordingError(file, channel.topic, found, "a message definition (ros2msg or ros2idl)") from None
    return lambda payload: read_message(payload, types, channel.type)


@functools.lru_cache(maxsize=64)
def is_standard(channel: Channel) -> bool:
    """Tell whether the bag's definition of the type has the fields of ROS 2 Jazzy, all the way down.

    Raises:
        ValueError: The bag's definition cannot be read.
    """
    bundled = _bundled(channel.type)
    return bool(bundled) and (not channel.definition or _own(channel) == bundled)


def stamp_of(header: Any) -> int:
    """Return `header.stamp` in ns."""
    return int(header.stamp.sec) * NANOSECONDS + int(header.stamp.nanosec)


def _numbers(kind: StreamKind, message: Any) -> list[float]:
    if kind is StreamKind.POINT:
        return [message.point.x, message.point.y, message.point.z]
    if kind is StreamKind.WRENCH:
        force, torque = message.wrench.force, message.wrench.torque
        return [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    return [message.temperature]


def read_typed(file: str, kind: StreamKind, batch: Batch, index: Int1D, joints: tuple[str, ...]) -> Samples:
    """Read messages one at a time.

    Args:
        file: Name for error messages.
        kind: What the messages are.
        batch: The messages.
        index: (n,) rows of the batch to read.
        joints: For joint states: names of the joints wanted.

    Raises:
        RecordingError: The bag's own definition of the type cannot be read.
    """
    read = deserializer(file, batch.channel)
    rows: list[tuple[int, int, list[float], list[float]]] = []
    order: list[int] = []
    frames: dict[str, int] = {}
    malformed, unusable = 0, 0
    example: tuple[str, ...] = ()
    for row in index:
        try:
            message = read(batch.payload(int(row)))
            stamp = stamp_of(message.header)
            values, efforts = [], []
            if kind is StreamKind.JOINTS:
                names = tuple(message.name)
                if len(message.position) != len(names) or not set(joints) <= set(names):
                    unusable += 1
                    example = example or names
                    continue
                pick = [names.index(joint) for joint in joints]
                values = [float(message.position[i]) for i in pick]
                has_efforts = len(message.effort) == len(names)
                efforts = [float(message.effort[i]) if has_efforts else np.nan for i in pick]
            else:
                values = [float(number) for number in _numbers(kind, message)]
            frame = str(message.header.frame_id)
        except FAULTS:
            malformed += 1
            continue
        frames[frame] = frames.get(frame, 0) + 1
        order.append(int(row))
        rows.append((stamp, int(batch.received[row]), values, efforts))
    columns = len(joints) if kind is StreamKind.JOINTS else kind.columns
    return Samples(
        np.array(order, np.int64),
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1] for row in rows], np.int64),
        np.array([row[2] for row in rows], np.float64).reshape(len(rows), columns),
        np.array([row[3] for row in rows], np.float64).reshape(len(rows), columns)
        if kind is StreamKind.JOINTS else None,
        frames, malformed, unusable, example,
    )  # fmt: skip
