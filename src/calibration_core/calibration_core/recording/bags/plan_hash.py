"""Which plan a recording measured: configurations are numbered within a plan, and those of two plans never mix.

A bag says so twice: in the custom data of its metadata, and in the events of the session.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.definitions.own import POINT_EXCLUDED, TRACKER_CLOCK
from calibration_core.recording.messages.typed import FAULTS, deserializer
from calibration_core.recording.session_values import point_excluded, tracker_clock
from calibration_core.recording.storage.batch import Batch
from calibration_core.timeseries import Note

KEY = "plan_sha256"  # in the custom data, and as a field of events
SHA256 = re.compile(r"[0-9a-f]{64}")


def plan_of_metadata(file: Path, custom: object) -> str:
    """Return the hash in the custom data of a bag's metadata; empty if there is none.

    Raises:
        RecordingError: It is no SHA-256.
    """
    value = custom.get(KEY, "") if isinstance(custom, Mapping) else ""
    if value and not (isinstance(value, str) and SHA256.fullmatch(value)):
        raise RecordingError(file, f"custom_data.{KEY}", quoted(value), "a SHA-256 in hexadecimal")
    return str(value)


def plans_of_events(file: str, batch: Batch, notes: list[Note]) -> set[str]:
    """Return the hashes that the events of a batch carry; what they say of the data, or cannot say, becomes notes."""
    found: set[str] = set()
    try:
        read = deserializer(file, batch.channel)
    except RecordingError as error:
        notes.append(Note("malformed", batch.channel.topic, f"events cannot be read: {error}", len(batch)))
        return found
    for row in range(len(batch)):
        try:
            event = read(batch.payload(row))
        except FAULTS:
            notes.append(Note("malformed", batch.channel.topic, "an event cannot be read"))
            continue
        value: Any = getattr(event, KEY, "")  # earlier versions have no such field
        if isinstance(value, str) and SHA256.fullmatch(value):
            found.add(value)
        if getattr(event, "kind", None) == POINT_EXCLUDED:
            notes.append(point_excluded(event.configuration, event.text))
        if getattr(event, "kind", None) == TRACKER_CLOCK:  # the last one is the surest
            clock = tracker_clock(event.text)
            notes[:] = [*(note for note in notes if note.kind != clock.kind), clock]
    return found


def one_plan(path: Path, plans: Collection[str]) -> str:
    """Return the hash of the one plan that was measured; empty where the recording does not know it.

    Raises:
        RecordingError: There are several.
    """
    known = sorted(set(plans) - {""})
    if len(known) > 1:
        text = f"configurations of {len(known)} plans (SHA-256 {', '.join(one[:12] + '…' for one in known[:3])})"
        raise RecordingError(path, "plan", text, "those of one, for their numbers count within a plan")
    return known[0] if known else ""
