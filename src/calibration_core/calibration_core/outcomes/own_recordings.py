"""Whether a model was identified from a recording: readings are compared, as far as they can be read again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from calibration_core.cell import Cell
from calibration_core.errors import InputError, RecordingError
from calibration_core.files.regular import read_regular
from calibration_core.model.identified.given import GivenModel
from calibration_core.observations.observe import observe
from calibration_core.outcomes.inputs import shared_with
from calibration_core.report.writing.output import MAX_RESULT, RESULT
from calibration_core.timeseries import Note, Readings

NOT_COMPARED = "not_compared"  # note: whether the model was identified from this recording is not known
EXPECTED = "places that were not used for the model"


def refuse_own(readings: Readings, model: GivenModel, cell: Cell) -> Readings:
    """Refuse a recording that the model was identified from, in whatever format it stands.

    A result in memory holds the readings that it was identified from.  Of a model file, the result.json beside it
    states the files and their digests; they are read again where they still stand there, unchanged.

    Args:
        readings: The recording.
        model: The model.
        cell: The cell of the recording.

    Returns:
        The readings, with a note where they could not be compared.

    Raises:
        RecordingError: For the most part, its readings are some of those that the model was identified from.
    """
    path = readings.provenance.path
    if model.recordings:
        _refuse_shared(readings, model.recordings)
        return readings
    stated = _stated(Path(model.file))
    if stated is None:
        text = (
            f"whether {model.file} was identified from this recording is not checked: beside a model file, the "
            "result.json of identify or diagnose names the recordings"
        )
        return readings.with_notes(Note(NOT_COMPARED, path, text))
    files, used = stated
    if used & set(readings.provenance.sha256.values()):
        raise RecordingError(path, "", f"the recording that {model.file} was identified from", EXPECTED)
    notes = []
    for file in files:
        again = _again(file, used, cell)
        if isinstance(again, Readings):
            _refuse_shared(readings, [again])
        else:
            text = f"whether this recording holds the readings of {file}, which the model was identified from, "
            notes.append(Note(NOT_COMPARED, path, f"{text}is not checked: {again}"))
    return readings.with_notes(*notes)


def _refuse_shared(readings: Readings, recordings: Sequence[Readings]) -> None:
    shared = shared_with(readings, recordings)
    if shared is not None:
        same, paths = shared
        found = f"{same} of {len(readings)} readings that are those of {paths}, which the model was identified from"
        raise RecordingError(readings.provenance.path, "", found, EXPECTED)


def _stated(model: Path) -> tuple[list[str], set[str]] | None:
    """Return recordings, and digests of all their files, as the result.json beside a model states them; None: none."""
    try:
        content = json.loads(read_regular(model.parent / RESULT, MAX_RESULT, "result"))
        rows = content["input"]["sha256"]
        used = {str(row["sha256"]) for row in rows if row["role"].startswith("recording")}
        files = [str(one["file"]) for one in content.get("recordings") or [content["recording"]]]
    except (InputError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None  # what stands there is no result of a model
    return (files, used) if used else None


def _again(file: str, used: set[str], cell: Cell) -> Readings | str:
    """Return the readings of a recording that a result names, or why they cannot be read again."""
    try:
        readings = observe(Path(file), cell)
    except InputError as error:
        return f"it cannot be read again ({error})"
    if not set(readings.provenance.sha256.values()) <= used:
        return "it has been changed since"
    return readings
