"""A foreign table read as a recording of a cell, where it can be read in one way only."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.travel import farthest
from calibration_core.errors import RecordingError
from calibration_core.recording.foreign.join import import_files
from calibration_core.timeseries import Note, Readings


def read_foreign(path: Path, cell: Cell) -> Readings:
    """Read a table of another program.

    Returns:
        Readings with the cell's points; a note says how the table was understood.

    Raises:
        RecordingError: Something is missing or can be read in more than one way; says which command to type.
    """
    command = f"or convert it: calibration import {path.name} --map map.yaml"
    try:
        travels = {f"q{i + 1}": float(most) for i, most in enumerate(farthest(cell)) if not np.isnan(most)}
        imported = import_files([path], travels=travels)
    except RecordingError as error:
        raise RecordingError(error.file, error.place, error.found, f"{error.expected}; {command}") from None
    readings = imported.readings
    if readings.q.shape[1] != len(cell.robot.joints):
        found = f"{readings.q.shape[1]} columns of joint angles"
        raise RecordingError(
            path, "columns", found, f"{len(cell.robot.joints)}, as the cell's robot has joints; {command}"
        )
    places = {name.lower(): i for i, name in enumerate(cell.points)}
    unknown = [name for name in readings.points if name.lower() not in places]
    if unknown:
        expected = f"points of the cell file ({', '.join(cell.points)}); {command}"
        raise RecordingError(path, "points", ", ".join(unknown[:8]), expected)
    point = np.array([places[name.lower()] for name in readings.points])[readings.point]
    source = imported.sources[0]
    units = {one.unit: one.meaning for one in reversed(source.taken) if one.unit}
    text = f"a foreign table: {source.form}; units " + ", ".join(
        f"{unit} ({meaning})" for unit, meaning in units.items()
    )
    read = dataclasses.replace(readings, points=cell.points, point=point)
    return read.with_notes(Note("foreign_table", path.name, text, len(readings)))
