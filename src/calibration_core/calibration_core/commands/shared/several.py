"""Several recordings of one robot as the input of a command."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

from calibration_core.cell import Cell
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.errors import InputError
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.identification.several.merge import as_one, cells_of, members_of
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.observations.observe import observe
from calibration_core.outcomes.inputs import as_anomalies, blocked, look, with_model_note, with_unit_note
from calibration_core.timeseries import Readings

if TYPE_CHECKING:
    from calibration_core.outcomes.together.prepare import Prepared


def read_recordings(arguments: argparse.Namespace) -> tuple[tuple[Cell, ...], tuple[Readings, ...]]:
    """Return the cells, one for each recording, and the recordings that a command names; of one set-up, as one.

    Raises:
        InputError: One cannot be read, or there are neither one nor as many cell files as recordings.
    """
    paths = arguments.recordings
    cells = cells_of(arguments.cells, len(paths), arguments.command)
    recordings = [observe(path, cell) for path, cell in zip(paths, cells, strict=True)]
    several = dated(recordings, arguments.date, arguments.command)
    if not arguments.same_setup:
        return cells, several
    if len(paths) == 1:
        raise InputError(arguments.command, "--same-setup", "one recording", "several, measured in one set-up")
    if len(arguments.cells) != 1:
        found = f"{len(arguments.cells)} cell files"
        raise InputError(arguments.command, "--same-setup", found, "one, which files of one set-up share")
    return cells[:1], (as_one(several),)


def dated(recordings: Sequence[Readings], day: str | None, who: str) -> tuple[Readings, ...]:
    """Return recordings with a stated day where they do not say when they were measured.

    Args:
        recordings: One or more.
        day: ISO 8601; None: nothing is stated.
        who: The command, for the message.

    Raises:
        InputError: All of them say it.
    """
    starts = [readings.provenance.start for readings in recordings]
    if day is None:
        return tuple(recordings)
    if all(starts):
        found = f"{day} for a recording that states its own date, {starts[0]}"
        raise InputError(who, "--date", found, "a recording without a date, or no --date")
    return tuple(
        dataclasses.replace(one, provenance=dataclasses.replace(one.provenance, start=one.provenance.start or day))
        for one in recordings
    )


def look_at_all(
    command: str,
    recordings: Sequence[Readings],
    cells: Sequence[Cell],
    test: Readings | None,
    given: GivenModel | None,
) -> Refusal | tuple[Anomaly, ...]:
    """Return the refusal of the first recording that cannot be used, or else what is wrong with any of them."""
    noted: tuple[Anomaly, ...] = ()
    for k, (readings, cell) in enumerate(zip(recordings, cells, strict=True)):
        seen = look(readings, test if k == 0 else None, cell)
        wrong = [one.of_recording(readings.provenance.path) for one in seen]
        if blocked(wrong):
            return Refusal.of(command, cell, readings, wrong, given)
        noted += as_anomalies(wrong)
    return noted


def prepared_from(
    recordings: Sequence[Readings],
    cells: Sequence[Cell],
    options: Options,
    test: Readings | None,
    given: GivenModel | None,
) -> Prepared:
    """Evaluate every recording by itself and put all together, the first named one first; arguments as for `prepare`.

    Raises:
        InputError: The robots differ, or a recording cannot be evaluated by itself.
    """
    from calibration_core.outcomes.together.prepare import prepare  # slow to load, and not needed for one recording

    noted = [with_unit_note(readings, cell) for readings, cell in zip(recordings, cells, strict=True)]
    noted[0] = with_model_note(noted[0], given)
    members = members_of(noted, cells)
    place = {id(member.readings): k for k, member in enumerate(members)}
    return prepare(members, [place[id(readings)] for readings in noted], options, test, given)
