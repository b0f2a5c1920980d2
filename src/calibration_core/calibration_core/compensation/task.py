"""A task as a table: target places of the tool, or joint angles, and the process wrench there."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import TaskError, quoted
from calibration_core.files.names import PRINTABLE, is_printable
from calibration_core.files.regular import read_regular
from calibration_core.timeseries import Float1D, Float2D, Int1D, read_only

POSE = ("x", "y", "z", "roll", "pitch", "yaw")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
SINGLE = ("temperature", "time")
MAX_BYTES = 1 << 26
MAX_ROWS = 500_000
SHORTEST = 0.999e-9  # s between two rows: a trajectory counts nanoseconds
LARGEST = 1e6  # m, rad, N, N*m, s: more is nothing that a robot does


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """Rows of a task, in order of travel.

    Attributes:
        header: Columns of the file, as they stand there.
        rows: The file's cells, for the table that is written.
        q: (m, n) rad, m where a joint slides: nominal joint angles; None where the file has none.
        pose: (m, 6) x, y, z (m), roll, pitch, yaw (rad) of the tool in the base frame; None where angles say it.
        wrench: (m, 6) N and N*m, of the environment on the robot at the wrench point; zeros without.
        temperature: (m,) degrees Celsius, NaN where unknown.
        time: (m,) s, NaN where unknown.
        path: (m,) number of the path that a row belongs to; -1: a place of its own.
        rate: (m, n) rad/s, m/s where a joint slides: rates of the nominal joints; None where the task has none.
        source: What the task is called in messages: the file, or who asks.
        labels: Where each row stands there; empty: by its number.
        load_source: Who states one wrench for all rows; empty: each row its own.
        remarks: What of the file was not used, in sentences.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    q: Float2D | None
    pose: Float2D | None
    wrench: Float2D
    temperature: Float1D
    time: Float1D
    path: Int1D
    rate: Float2D | None = None
    source: str | Path = "task"
    labels: tuple[str, ...] = ()
    load_source: str = ""
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        for field in ("q", "pose", "wrench", "temperature", "time", "rate"):
            value = getattr(self, field)
            object.__setattr__(self, field, None if value is None else read_only(value))
        object.__setattr__(self, "path", read_only(self.path, np.int64))

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.wrench)

    def with_wrench(self, wrench: Sequence[float], source: str = "") -> Task:
        """Return the task under one wrench for all rows, (6,) N and N*m, with a remark where its own were others."""
        load = np.tile(np.asarray(wrench, dtype=float), (len(self), 1))
        others = int(np.any(load != self.wrench, axis=1).sum()) if WRENCH[0] in self.header else 0
        numbers = " ".join(f"{value:zg}" for value in load[0])
        remark = (
            f"The wrenches of {self.source} (columns fx ... tz) were not used in {others} of {len(self)} rows: the one "
            f"that was given for all rows, {numbers}, holds."
        )
        remarks = (*self.remarks, *([remark] if others else []))
        return dataclasses.replace(self, wrench=load, load_source=source, remarks=remarks)

    def fault(self, row: int, found: str, expected: str, *, of_load: bool = False) -> TaskError:
        """Return the error for a row, counted from 0, that cannot be used, or for its load."""
        if of_load and self.load_source:
            return TaskError(self.load_source, "", found, expected)
        place = self.labels[row] if self.labels else f"row {row + 1}"
        return TaskError(self.source, place, found, expected)


def places(
    q: Float2D | None = None, pose: Float2D | None = None, wrench: Float2D | None = None, *, one_path: bool = False
) -> Task:
    """Return a task that stands in no file.

    Args:
        q: (m, n) rad; None where poses say it.
        pose: (m, 6) m and rad; None where angles say it.
        wrench: (m, 6) N and N*m; None: none.
        one_path: Whether the rows are one path in order of travel.
    """
    given = q if q is not None else pose
    m = 0 if given is None else len(given)
    unknown = np.full(m, np.nan)
    force = np.zeros((m, 6)) if wrench is None else wrench
    return Task((), ((),) * m, q, pose, force, unknown, unknown, np.full(m, 0 if one_path else -1))


def read_task(path: Path, cell: Cell) -> Task:
    """Read a task.

    Raises:
        TaskError: It cannot be read; names line and column, what was found and what was expected.
    """
    raw = read_regular(path, MAX_BYTES, "task (CSV)", TaskError)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TaskError(path, f"byte {error.start}", quoted(raw[error.start : error.start + 1]), "UTF-8") from None
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    lines: list[int] = []
    rows: list[tuple[str, ...]] = []
    try:
        header = tuple(name.strip() for name in next(reader, []))
        _check_header(path, header, cell)
        for fields in reader:
            if not any(field.strip() for field in fields):
                continue
            if len(fields) != len(header):
                raise TaskError(
                    path, f"line {reader.line_num}", f"{len(fields)} cells", f"{len(header)}, as the header"
                )
            lines.append(reader.line_num)
            rows.append(tuple(fields))
            if len(rows) > MAX_ROWS:
                raise TaskError(path, f"line {reader.line_num}", "more rows", f"at most {MAX_ROWS}")
    except csv.Error as error:
        raise TaskError(path, f"line {reader.line_num}", str(error), "comma-separated values") from None
    if not rows:
        raise TaskError(path, "", "no rows", "at least one place")
    return _task(path, header, lines, rows, cell)


def _check_header(path: Path, header: tuple[str, ...], cell: Cell) -> None:
    if len(header) == 1 and ";" in header[0]:
        expected = "columns separated by commas, and numbers with a decimal point"
        raise TaskError(path, "line 1", "columns separated by semicolons", expected)
    angles = tuple(f"q{i + 1}" for i in range(len(cell.robot.joints)))
    known = {*POSE, *angles, *WRENCH, *SINGLE, "path"}
    for name in header:
        if name not in known:
            raise TaskError(
                path, "line 1", quoted(name), f"one of {', '.join((*POSE, *angles, *WRENCH, *SINGLE, 'path'))}"
            )
        if header.count(name) > 1:
            raise TaskError(path, "line 1", f"{quoted(name)} twice", "every column once")
    for group in (POSE, angles, WRENCH):
        there = [name for name in group if name in header]
        if there and len(there) < len(group):
            lacking = next(name for name in group if name not in header)
            raise TaskError(path, "line 1", f"{there[0]} without {lacking}", f"all of {', '.join(group)}")
    if POSE[0] not in header and angles[0] not in header:
        raise TaskError(
            path, "line 1", quoted(", ".join(header)), f"{', '.join(POSE)}, or {angles[0]} ... {angles[-1]}"
        )


def _task(path: Path, header: tuple[str, ...], lines: list[int], rows: list[tuple[str, ...]], cell: Cell) -> Task:
    place = {name: k for k, name in enumerate(header)}

    def columns(names: Iterable[str]) -> Float2D | None:
        chosen = [name for name in names if name in place]
        if not chosen:
            return None
        table = [
            [_number(path, line, name, row[place[name]]) for name in chosen]
            for line, row in zip(lines, rows, strict=True)
        ]
        return np.array(table)

    labels = [row[place["path"]].strip() for row in rows] if "path" in place else [""] * len(rows)
    for line, label in zip(lines, labels, strict=True):
        if not is_printable(label):
            raise TaskError(path, f"line {line}, column path", quoted(label), PRINTABLE)
    m, n = len(rows), len(cell.robot.joints)
    wrench, warm, when = columns(WRENCH), columns(["temperature"]), columns(["time"])
    time = np.full(m, np.nan) if when is None else when[:, 0]
    _check_times(path, lines, time)
    return Task(
        header=header,
        rows=tuple(rows),
        q=columns(f"q{i + 1}" for i in range(n)),
        pose=columns(POSE),
        wrench=np.zeros((m, 6)) if wrench is None else wrench,
        temperature=np.full(m, np.nan) if warm is None else warm[:, 0],
        time=time,
        path=_paths(labels),
        source=path,
        labels=tuple(f"line {line}" for line in lines),
    )


def _paths(labels: list[str]) -> Int1D:
    """Number the paths; an empty cell is a place of its own."""
    numbers = {label: k for k, label in enumerate(dict.fromkeys(label for label in labels if label))}
    return np.array([numbers.get(label, -1) for label in labels], dtype=np.int64)


def _check_times(path: Path, lines: list[int], time: Float1D) -> None:
    """Refuse times that do not increase from row to row; rows without one are passed over."""
    stated = np.flatnonzero(np.isfinite(time))
    row = first_not_later(time[stated])
    if row is None:
        return
    now, before = stated[row], stated[row - 1]
    found, expected = f"{time[now]:g} s", f"more than {time[before]:g} s of line {lines[before]}: times increase"
    raise TaskError(path, f"line {lines[now]}, column time", found, expected)


def first_not_later(time: Float1D) -> int | None:
    """Return the first of some times (m,) s that is not later than the one before, by a nanosecond; None: all are."""
    wrong = np.flatnonzero(~(np.diff(time) >= SHORTEST))
    return int(wrong[0]) + 1 if len(wrong) else None


def _number(path: Path, line: int, name: str, text: str) -> float:
    if name in SINGLE and not text.strip():
        return math.nan
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > LARGEST or "_" in text:
        raise TaskError(path, f"line {line}, column {name}", quoted(text), f"a number of at most {LARGEST:g}")
    return value
