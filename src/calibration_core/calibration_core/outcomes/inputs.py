"""The inputs of an outcome: their digests, the look at them before any physics, and errors that name their file."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from calibration_core.cell import Cell
from calibration_core.errors import CellError, InputError, ModelFileError, RecordingError
from calibration_core.files.regular import read_regular
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.input_checks.anomaly import InputAnomaly, check_lengths
from calibration_core.input_checks.check import check_inputs, unit_note
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.robot import chain_of
from calibration_core.observations.kinds import SAME, reading_keys
from calibration_core.observations.observe import observe
from calibration_core.recording.source import sha256_of
from calibration_core.report.writing.output import MAX_RESULT, RESULT
from calibration_core.timeseries import Note, Readings


@contextlib.contextmanager
def naming_model(model: Path | None) -> Iterator[None]:
    """Let errors about a given model that are raised inside name its file."""
    try:
        yield
    except ModelFileError as error:
        raise ModelFileError(model or error.file, error.place, error.found, error.expected) from None


def digest_of(path: Path) -> dict[str, str]:
    """Return file name -> SHA-256 of one input file."""
    return {path.name: sha256_of(path)}


def look(readings: Readings, test: Readings | None, cell: Cell) -> tuple[InputAnomaly, ...]:
    """Return what is wrong with the recording and with the one that it is tested on.

    Raises:
        CellError: The robot cannot be read.
    """
    found = check_inputs(readings, cell)
    of_test = () if test is None else check_inputs(test, cell)
    return (*found, *(dataclasses.replace(one, text=f"in the test recording: {one.text}") for one in of_test))


def refuse_fitted(test: Readings | None, recordings: Sequence[Readings]) -> None:
    """Refuse a test recording whose readings are, for the most part, those of a recording that is fitted.

    Raises:
        RecordingError: They are.
    """
    if test is None or not len(test):
        return
    shared = shared_with(test, recordings)
    if shared is not None:
        same, paths = shared
        found = f"{same} of {len(test)} readings that are those of {paths}, which is fitted"
        raise RecordingError(test.provenance.path, "--test", found, "a recording that is not fitted")


def shared_with(readings: Readings, recordings: Sequence[Readings]) -> tuple[int, str] | None:
    """Return how many readings are those of some recordings, and of which; None where most of them are not.

    Readings are compared, not files: a copy, another format or another order holds the same readings.
    """
    own = reading_keys(readings)
    shared = {other.provenance.path: own & reading_keys(other) for other in recordings}
    same = len(set().union(*shared.values()))
    if same <= SAME * len(own):
        return None
    return same, ", ".join(path for path, rows in shared.items() if rows)


def blocked(found: Sequence[InputAnomaly]) -> bool:
    """Say whether nothing may be claimed."""
    return any(one.blocks for one in found)


def as_anomalies(found: Sequence[InputAnomaly]) -> tuple[Anomaly, ...]:
    """Return what does not block as anomalies of the answer."""
    return tuple(
        Anomaly(one.kind, one.location, None, one.magnitude, one.unit, one.text, one.remedy)
        for one in found
        if not one.blocks
    )


def with_unit_note(readings: Readings, cell: Cell) -> Readings:
    """Return the readings with a note where the unit of forces and positions cannot be checked, or only coarsely."""
    note = unit_note(readings, cell)
    return readings if note is None else readings.with_notes(note)


def with_model_note(readings: Readings, given: GivenModel | None) -> Readings:
    """Return the readings with a note where a given model file states no covariance, so that nothing has intervals."""
    return readings if given is None else readings.with_notes(*given.notes)


def refuse_lengths(cell: Cell) -> None:
    """Refuse a cell file whose lengths no robot, tracker or tool has, where there is no recording to judge.

    Raises:
        CellError: Lengths look like millimetres.
    """
    for wrong in check_lengths(cell, chain_of(cell)):
        raise CellError(cell.path, "robot and frames", wrong.text, f"lengths in m: {wrong.remedy}")


Inputs = Mapping[str, Mapping[str, str]]


# --- whether a model was identified from a recording ------------------------------------------------------------------


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
