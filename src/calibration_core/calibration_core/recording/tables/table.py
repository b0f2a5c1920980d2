"""Measurement tables: CSV <-> readings, every fault named with line and column."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from calibration_core.cell import Cell
from calibration_core.errors import RecordingError, quoted
from calibration_core.files.csv_cells import inert, meant
from calibration_core.files.written import number
from calibration_core.recording.dates import start_of
from calibration_core.recording.foreign.meaning import TURNS
from calibration_core.recording.foreign.units import split_unit
from calibration_core.recording.source import sha256_of
from calibration_core.recording.tables.checks import check_plausible, check_steps
from calibration_core.recording.tables.columns import INTEGERS, OPTIONAL, OURS, POSITION, WRENCH, checked_columns
from calibration_core.timeseries import Float2D, Provenance, Readings

MAX_BYTES = 1 << 27  # some 800,000 readings; as many as are read in half a minute
MAX_LINE = 1 << 16
MAX_INTEGER = 1 << 53
BLOCK = 4096


def read_table(path: Path, cell: Cell, *, simulated: bool = False) -> Readings:
    """Read a measurement table; one of another program is converted where it can be read in one way only.

    Args:
        path: The table.
        cell: The cell.
        simulated: Whether a simulation wrote it: where it is compared its units are judged, and it may hold tool poses.

    Returns:
        One row per line, in the order of the file; `wrench` is None where the table has no wrench columns, and `time`
        and `temperature` are NaN where unknown.

    Raises:
        RecordingError: Names the line and the column, what was found and what was expected.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            size = stream.seek(0, 2)
            if size > MAX_BYTES:
                raise RecordingError(path, "", f"{size} bytes", f"a measurement table of at most {MAX_BYTES} bytes")
            stream.seek(0)
            if _is_foreign(stream.readline(MAX_LINE), simulated=simulated):
                return _read_foreign(path, cell, simulated=simulated)
            stream.seek(0)
            columns, numbers, points, lines = _parse(path, stream, cell)
    except OSError as error:
        raise RecordingError(path, "", error.strerror or str(error), "a readable measurement table") from None
    place = {name: i for i, name in enumerate(columns)}
    count = len(lines)

    def column(name: str) -> NDArray[np.float64]:
        return numbers[:, place[name]] if name in place else np.full(count, np.nan)

    readings = Readings(
        points=cell.points,
        configuration=column("configuration").astype(np.int64),
        step=column("step").astype(np.int64),
        point=points,
        q=np.column_stack([column(f"q{i + 1}") for i in range(len(cell.robot.joints))]),
        position=np.column_stack([column(name) for name in POSITION]),
        wrench=np.column_stack([column(name) for name in WRENCH]) if WRENCH[0] in place else None,
        time=column("time"),
        temperature=column("temperature"),
        provenance=Provenance(
            str(path), "csv", {path.name: sha256_of(path)}, {"rows": count}, start_of(column("time"))
        ),
    )
    if not simulated:
        check_plausible(path, readings, cell, lines)
    return readings.with_notes(*check_steps(path, readings, lines))


def _read_foreign(path: Path, cell: Cell, *, simulated: bool) -> Readings:
    # what reads other programs' tables is slow to load, and most recordings are not of this kind
    from calibration_core.recording.foreign.direct import read_foreign

    readings = read_foreign(path, cell, simulated=simulated)
    lines = np.arange(1, len(readings) + 1)
    if not simulated:
        check_plausible(path, readings, cell, lines)
    return readings.with_notes(*check_steps(path, readings, lines))


def _is_foreign(first: bytes, *, simulated: bool) -> bool:
    """Tell from the first line whether a table is another program's.

    Ours have numbers, or lack one column at most; none of their columns states a unit.
    """
    if not first.strip() or first[:1] == b"\x00":
        return False
    names = {name.strip() for name in first.decode("utf-8-sig", errors="replace").split(",")}
    if any(split_unit(name)[1] for name in names) or (simulated and any(set(turns) <= names for turns in TURNS)):
        return True
    return not (set(INTEGERS) <= names or len(names & OURS) >= len(OURS) - 1)


def _parse(
    path: Path, stream: IO[bytes], cell: Cell
) -> tuple[list[str], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return names of the number columns, the numbers (m, columns), point indices (m,) and line numbers (m,)."""
    reader = csv.reader(_lines(path, stream), strict=True)
    try:
        header = next(reader, None)
        names = checked_columns(path, header or (), cell, "line 1")
        columns = [name for name in names if name != "point"]
        parse = _RowParser(path, names, cell.points)
        blocks: list[NDArray[np.float64]] = []
        rows: list[list[float]] = []
        points: list[int] = []
        lines: list[int] = []
        for fields in reader:
            if not fields:
                continue
            values, point = parse(fields, reader.line_num)
            rows.append(values)
            points.append(point)
            lines.append(reader.line_num)
            if len(rows) == BLOCK:
                blocks.append(np.array(rows))
                rows = []
    except csv.Error as error:
        raise RecordingError(path, f"line {reader.line_num}", str(error), "comma-separated values") from None
    if not lines:
        raise RecordingError(path, "", "a header without rows" if header else "nothing", "at least one reading")
    if rows:
        blocks.append(np.array(rows))
    return columns, np.concatenate(blocks), np.array(points, np.int64), np.array(lines, np.int64)


def _lines(path: Path, stream: IO[bytes]) -> Iterator[str]:
    """Decode line by line, never more than a line's worth at a time."""
    number = 0
    while raw := stream.readline(MAX_LINE):
        number += 1
        place = f"line {number}"
        if b"\x00" in raw:
            raise RecordingError(path, place, "a zero byte", "text (CSV in UTF-8)")
        if len(raw) == MAX_LINE and not raw.endswith(b"\n"):
            raise RecordingError(path, place, f"more than {MAX_LINE} bytes in one line", "a measurement table (CSV)")
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError as error:
            found = quoted(raw[error.start : error.start + 1])
            raise RecordingError(path, f"{place}, byte {error.start + 1}", found, "text (CSV in UTF-8)") from None
        yield text


class _RowParser:
    """Turns the fields of a line into numbers and the index of the point."""

    def __init__(self, path: Path, names: list[str], points: tuple[str, ...]) -> None:
        self._path, self._names = path, names
        self._width = len(names)
        self._point = names.index("point")
        self._columns = [name for name in names if name != "point"]
        self._points = {name: i for i, name in enumerate(points)}

    def __call__(self, fields: list[str], line: int) -> tuple[list[float], int]:
        if len(fields) != self._width:
            raise self._fault(line, "", f"{len(fields)} fields", f"{self._width} as in the header")
        name = fields.pop(self._point).strip()
        point = self._points.get(name, self._points.get(meant(name)))
        if point is None:
            raise self._fault(line, "point", quoted(name), "one of " + ", ".join(self._points))
        try:
            values = list(map(float, fields))
            plain = math.isfinite(sum(values)) and "_" not in "".join(fields)
        except ValueError:
            values, plain = [], False
        if not plain:
            values = [self._number(text, name, line) for text, name in zip(fields, self._columns, strict=True)]
        for column in INTEGERS:
            i = self._columns.index(column)
            if not fields[i].strip().lstrip("+-").isdecimal() or abs(values[i]) > MAX_INTEGER:
                raise self._fault(line, column, quoted(fields[i]), "an integer")
        return values, point

    def _number(self, text: str, column: str, line: int) -> float:
        if not text.strip() and column in OPTIONAL:
            return math.nan
        try:
            value = float(text) if "_" not in text else math.nan
        except ValueError:
            raise self._fault(line, column, quoted(text), "a number") from None
        if not math.isfinite(value):
            raise self._fault(line, column, quoted(text), "a finite number")
        return value

    def _fault(self, line: int, column: str, found: str, expected: str) -> RecordingError:
        place = f"line {line}, column {column}" if column else f"line {line}"
        return RecordingError(self._path, place, found, expected)


def write_table(path: Path, readings: Readings) -> None:
    """Write readings as a measurement table; what is read back is equal to the bit, but for the sign of a zero."""
    columns: list[tuple[str, list[str]]] = [
        ("configuration", [str(value) for value in readings.configuration.tolist()]),
        ("step", [str(value) for value in readings.step.tolist()]),
    ]
    for name in OPTIONAL:
        values = getattr(readings, name)
        if np.isfinite(values).any():
            columns.append((name, ["" if math.isnan(value) else number(value) for value in values.tolist()]))
    columns += _numeric([f"q{i + 1}" for i in range(readings.q.shape[1])], readings.q)
    columns += [] if readings.wrench is None else _numeric(WRENCH, readings.wrench)
    columns.append(("point", [inert(readings.points[i]) for i in readings.point.tolist()]))
    columns += _numeric(POSITION, readings.position)
    partial = Path(path).with_name(f".{Path(path).name}.part")
    try:
        with partial.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow([name for name, _ in columns])
            writer.writerows(zip(*(values for _, values in columns), strict=True))
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _numeric(names: Sequence[str], values: Float2D) -> list[tuple[str, list[str]]]:
    return [(name, [number(value) for value in one.tolist()]) for name, one in zip(names, values.T, strict=True)]
