"""The standard's conditions as a suite has seen them while measuring: messages of a bag to values."""

from __future__ import annotations

from typing import Any

from calibration_core.errors import RecordingError
from calibration_core.recording.messages.typed import FAULTS, deserializer
from calibration_core.recording.storage.batch import Batch
from calibration_core.timeseries import Condition, Note, Override

VERDICTS = {0: None, 1: True, 2: False}  # constants of the message


def read_conditions(file: str, batch: Batch, notes: list[Note]) -> list[tuple[Condition, ...]]:
    """Return what the messages of a batch say, in their order; what cannot be read becomes a note."""
    found: list[tuple[Condition, ...]] = []
    try:
        read = deserializer(file, batch.channel)
    except RecordingError as error:
        notes.append(Note("malformed", batch.channel.topic, f"conditions cannot be read: {error}", len(batch)))
        return found
    for row in range(len(batch)):
        try:
            found.append(tuple(_condition(one) for one in read(batch.payload(row)).conditions))
        except (*FAULTS, KeyError):
            notes.append(Note("malformed", batch.channel.topic, "a message of conditions cannot be read"))
    return found


def _condition(message: Any) -> Condition:
    override = message.override
    return Condition(
        name=str(message.name),
        clause=str(message.clause),
        requirement=str(message.requirement),
        limit=str(message.limit),
        value=str(message.value),
        met=VERDICTS[int(message.verdict)],
        shall=bool(message.shall),
        override=Override(str(override.condition), str(override.operator_name), str(override.reason))
        if override.operator_name
        else None,
    )
