"""Columns that are in memory already, as a recording: what a measurement table holds, without the file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration_core.cell import Cell
from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.dates import start_of
from calibration_core.recording.tables.checks import check_plausible, check_steps
from calibration_core.recording.tables.columns import (
    INTEGERS,
    OPTIONAL,
    POSITION,
    WRENCH,
    checked_columns,
    joint_columns,
)
from calibration_core.timeseries import Int1D, Provenance, Readings

ROW = "row"


def readings_of_columns(columns: Mapping[str, Any], cell: Cell, name: str = "arrays") -> Readings:
    """Return the readings that columns of equal length hold.

    Args:
        columns: Name -> (m,) values; names and units are those of the measurement table.
        cell: Number of joints, names of points, and how the table is to be read.
        name: What the data are called in messages and results.

    Raises:
        RecordingError: A column is unknown, missing, of another length or holds what is no finite number; rows are
            counted from 0.
    """
    checked_columns(name, [str(key) for key in columns], cell, "columns")
    numbers = {key: _numbers(name, key, columns[key]) for key in columns if key != "point"}
    rows = len(numbers[INTEGERS[0]])
    points = _points(name, columns["point"], cell.points)
    for key, values in {**numbers, "point": points}.items():
        if len(values) != rows:
            raise RecordingError(name, f"column {key}", f"{len(values)} rows", f"{rows}, as in {INTEGERS[0]}")
    if not rows:
        raise RecordingError(name, "", "columns without rows", "at least one reading")

    def stacked(names: Iterable[str]) -> NDArray[np.float64]:
        return np.column_stack([numbers[key] for key in names])

    unknown = np.full(rows, np.nan)
    digest = hashlib.sha256()
    for key in sorted(numbers):
        digest.update(key.encode() + numbers[key].tobytes())
    digest.update(points.tobytes())
    readings = Readings(
        points=cell.points,
        configuration=numbers["configuration"].astype(np.int64),
        step=numbers["step"].astype(np.int64),
        point=points,
        q=stacked(joint_columns(cell)),
        position=stacked(POSITION),
        wrench=stacked(WRENCH) if WRENCH[0] in numbers else None,
        time=numbers.get("time", unknown),
        temperature=numbers.get("temperature", unknown),
        provenance=Provenance(
            name, "arrays", {name: digest.hexdigest()}, {"rows": rows}, start_of(numbers.get("time", unknown))
        ),
    )
    indices = np.arange(rows)
    check_plausible(Path(name), readings, cell, indices, ROW)
    return readings.with_notes(*check_steps(Path(name), readings, indices, ROW))


def _numbers(name: str, key: str, values: Any) -> NDArray[np.float64]:
    """Return one column as finite numbers; `OPTIONAL` ones may be NaN."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordingError(name, f"column {key}", str(error), "numbers") from None
    if found.ndim != 1:
        raise RecordingError(name, f"column {key}", f"an array of shape {found.shape}", "one value per row")
    wrong = np.isinf(found) if key in OPTIONAL else ~np.isfinite(found)
    expected = "a finite number"
    if key in INTEGERS and not wrong.any():
        wrong, expected = found != np.round(found), "an integer"
    if wrong.any():
        row = int(np.argmax(wrong))
        raise RecordingError(name, f"{ROW} {row}, column {key}", quoted(float(found[row])), expected)
    return found


def _points(name: str, values: Any, known: tuple[str, ...]) -> Int1D:
    """Return the index of every row's point."""
    places = {point: index for index, point in enumerate(known)}
    texts = [str(value).strip() for value in values]
    for row, text in enumerate(texts):
        if text not in places:
            raise RecordingError(name, f"{ROW} {row}, column point", quoted(text), f"one of {', '.join(known)}")
    return np.array([places[text] for text in texts], dtype=np.int64)
