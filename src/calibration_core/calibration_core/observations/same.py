"""Whether recordings hold the same readings: files differ in line ends and formats, measurements do not."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calibration_core.errors import RecordingError
from calibration_core.timeseries import Readings

SAME = 0.5  # of the readings: more in common is the same recording
DIGITS = 6  # of m and rad: readings that agree to so many are the same, for noise is larger


def reading_keys(readings: Readings) -> set[bytes]:
    """Return every reading by its angles and position; formats differ in how a wrench is averaged."""
    values = np.round(np.column_stack([readings.q, readings.position]), DIGITS) + 0.0  # no negative zeros
    return {row.tobytes() for row in values}


def refuse_same(recordings: Iterable[Readings]) -> None:
    """Refuse recordings of which one holds, for the most part, the readings of another.

    Raises:
        RecordingError: There are two such; names the later one.
    """
    before: list[tuple[str, set[bytes]]] = []
    for readings in recordings:
        path, own = readings.provenance.path, reading_keys(readings)
        for other, theirs in before:
            same = len(own & theirs)
            if same > SAME * min(len(own), len(theirs)):
                found = f"{same} of {len(own)} readings that are those of {other}"
                raise RecordingError(path, "", found, "every recording once")
        before.append((path, own))
