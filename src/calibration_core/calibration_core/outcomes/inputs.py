"""The inputs of an outcome: their digests, the look at them before any physics, and errors that name their file."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from calibration_core.cell import Cell
from calibration_core.errors import CellError, ModelFileError, RecordingError
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.input_checks.check import check_inputs, unit_note
from calibration_core.input_checks.units import check_lengths
from calibration_core.model.identified.given import GivenModel
from calibration_core.model.robot import chain_of
from calibration_core.observations.kinds import SAME, reading_keys
from calibration_core.recording.source import sha256_of
from calibration_core.timeseries import Readings


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
