"""A session's database as a recording: the readings that were confirmed while measuring, without their bag.

A confirmed reading is the average over one settled window of the instruments.  A bag of the same session holds the
samples of that window and a little more, and is averaged anew: its readings have the same configurations, steps and
points, and differ from the confirmed ones by the noise of the averages.  Of a configuration that was measured several
times one attempt counts: the last one that was completed, else the one with most steps, the last of equals.

The database is a file that anybody may have written.  It is opened as a copy, never written to, and nothing in it is
run: only its tables are read, within a number of steps and rows that no session reaches.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from calibration_core.cell import Cell
from calibration_core.errors import RecordingError, quoted
from calibration_core.files.regular import open_regular
from calibration_core.recording.session_values import (
    ConfirmedReading,
    as_readings,
    checked_reading,
    point_excluded,
    tracker_clock,
)
from calibration_core.recording.source import SESSION_DATABASE, sha256_of
from calibration_core.timeseries import Condition, Note, Override, Readings

MAGIC = b"SQLite format 3\x00"
SCHEMA = 1
MAX_BYTES = 1 << 29  # of the database; a step of three points takes some 5 kB
MAX_VALUE = 1 << 20  # bytes of one value
MAX_ROWS = 300_000  # of one table: 10,000 configurations of ten steps and three points
MAX_CONDITIONS = 1 << 24  # bytes of all that is said of the standard's conditions
STEPS = 10_000  # of SQLite's machine between two looks at ...
LOOKS = 100_000  # ... how many of them there may be
COPIES = 5  # tries to copy a database that is being written to
SHA256 = re.compile(r"[0-9a-f]{64}")
NEEDED = ("session", "attempt", "reading")
VERDICTS = (None, True, False)
CLOCK = "tracker_clock"  # likewise: "NODE: FIGURES"
EXCLUDED = "point_excluded"  # kind of an event; its text: CONFIGURATION.STEP POINT by NAME: REASON


def read_session(path: Path, cell: Cell) -> tuple[Readings, tuple[tuple[Condition, ...], ...]]:
    """Read what a session has confirmed, whether or not it is still being written to.

    Returns:
        The readings in the order of time, and how the standard's conditions stood: every change.

    Raises:
        RecordingError: It is no session's database, is damaged, belongs to another robot, or confirms nothing.
    """
    file = path / SESSION_DATABASE if path.is_dir() else path
    with _copy(file) as copy:
        try:
            with contextlib.closing(_opened(copy)) as database:
                tables = _tables(file, database)
                plan, points = _head(file, database, cell)
                attempts = _attempts(file, database)
                rows = _rows(file, database, cell, attempts)
                conditions = _conditions(file, database) if "condition" in tables else ()
                excluded = _reported(file, database) if "event" in tables else []
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            raise RecordingError(file, "", f"an unusable database ({error})", "a session's database") from None
        digests = {one.name: sha256_of(one) for one in sorted(copy.parent.iterdir()) if not one.name.endswith("-shm")}
    chosen, notes = _chosen(rows, attempts, cell)
    notes += excluded
    if not chosen:
        raise RecordingError(file, "table reading", "no reading", "at least one that was confirmed")
    absent = [name for name in points if name not in {one.point for one in chosen}]
    if absent:
        notes.append(Note("missing_point", file.name, f"not in the session: {', '.join(absent)}", len(absent)))
    readings = as_readings(chosen, cell.points, str(path), sha256=digests, plan_sha256=plan, notes=tuple(notes))
    return readings, conditions


@contextlib.contextmanager
def _copy(file: Path) -> Iterator[Path]:
    """Copy a database with its write-ahead log, as it was at one moment, to a folder that is deleted afterwards."""
    log = file.with_name(file.name + "-wal")
    try:
        with open_regular(file) as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise RecordingError(file, "", "another kind of file", "a session's database (SQLite)")
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / file.name
            for _ in range(COPIES):
                before = [_state(one) for one in (file, log)]
                size = sum(state[0] for state in before)
                if size > MAX_BYTES:
                    raise RecordingError(file, "", f"{size} bytes", f"a session's database of at most {MAX_BYTES}")
                shutil.copyfile(file, copy)
                if log.is_file():
                    shutil.copyfile(log, copy.with_name(log.name))
                if before == [_state(one) for one in (file, log)]:
                    break
            yield copy
    except OSError as error:
        raise RecordingError(file, "", error.strerror or str(error), "a readable file") from None


def _state(file: Path) -> tuple[int, int]:
    try:
        found = file.stat()
    except FileNotFoundError:
        return 0, 0
    return found.st_size, found.st_mtime_ns


def _opened(file: Path) -> sqlite3.Connection:
    database = sqlite3.connect(file)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE)
    looks = iter(range(LOOKS))
    database.set_progress_handler(lambda: next(looks, None) is None, STEPS)
    database.execute("PRAGMA trusted_schema = OFF")
    return database


def _tables(file: Path, database: sqlite3.Connection) -> set[str]:
    """Return the names of the ordinary tables; views and virtual tables are none."""
    rows = database.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table' LIMIT 1000").fetchall()
    tables = {str(name) for name, text in rows if not str(text).lstrip().upper().startswith("CREATE VIRTUAL")}
    absent = [name for name in NEEDED if name not in tables]
    if absent:
        raise RecordingError(file, "", f"no table {absent[0]}", f"a session's database: tables {', '.join(NEEDED)}")
    return tables


def _head(file: Path, database: sqlite3.Connection, cell: Cell) -> tuple[str, tuple[str, ...]]:
    """Return the hash of the plan and the names of the points."""
    rows = database.execute("SELECT schema, plan_sha256, points FROM session LIMIT 2").fetchall()
    if len(rows) != 1 or rows[0][0] != SCHEMA:
        found = f"schema {quoted(rows[0][0])}" if len(rows) == 1 else f"{len(rows)} rows"
        raise RecordingError(file, "table session", found, f"one row, schema {SCHEMA}")
    _, plan, points = rows[0]
    if not isinstance(plan, str) or not SHA256.fullmatch(plan):
        raise RecordingError(file, "session.plan_sha256", quoted(plan), "a SHA-256 in hexadecimal")
    names = _json(file, "session.points", points)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise RecordingError(file, "session.points", quoted(names), "a list of names")
    foreign = [name for name in names if name not in cell.points]
    if foreign:
        raise RecordingError(
            file, "session.points", quoted(foreign[0]), f"points of the cell: {', '.join(cell.points)}"
        )
    return plan, tuple(names)


def _attempts(file: Path, database: sqlite3.Connection) -> dict[int, bool]:
    """Return the number of every attempt, and whether it was completed."""
    found: dict[int, bool] = {}
    for number, outcome in _limited(file, database, "attempt", "id, outcome"):
        if isinstance(number, bool) or not isinstance(number, int):
            raise RecordingError(file, "attempt.id", quoted(number), "an integer")
        found[number] = outcome == "completed"
    return found


def _rows(
    file: Path, database: sqlite3.Connection, cell: Cell, attempts: dict[int, bool]
) -> list[tuple[int, ConfirmedReading]]:
    """Return every reading with the number of its attempt, checked."""
    found: list[tuple[int, ConfirmedReading]] = []
    seen: set[tuple[Any, ...]] = set()
    columns = "attempt, configuration, step, point, time, content"
    for line, row in enumerate(_limited(file, database, "reading", columns), start=1):
        attempt, configuration, step, point, time, text = row
        place = f"reading {line}"
        if attempt not in attempts:
            raise RecordingError(file, f"{place}, attempt", quoted(attempt), "an attempt of the session")
        for name, value in (("configuration", configuration), ("step", step), ("time", time)):
            top = 1 << (63 if name == "time" else 32)
            if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < top:
                raise RecordingError(file, f"{place}, {name}", quoted(value), f"an integer from 0 to {top - 1}")
        if point not in cell.points:
            raise RecordingError(file, f"{place}, point", quoted(point), f"one of {', '.join(cell.points)}")
        key = (attempt, configuration, step, point)
        if key in seen:
            raise RecordingError(file, place, f"configuration {configuration}, step {step}, {point} twice", "it once")
        seen.add(key)
        content = _json(file, f"{place}, content", text)
        try:
            reading = checked_reading(configuration, step, point, time, content, len(cell.robot.joints))
        except ValueError as error:
            found_text, _, expected = str(error).partition("|")
            raise RecordingError(file, f"{place}, content", found_text, expected) from None
        found.append((int(attempt), reading))
    return found


def _limited(file: Path, database: sqlite3.Connection, table: str, columns: str) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a table in the order in which they were written."""
    for number, row in enumerate(database.execute(f"SELECT {columns} FROM {table} ORDER BY id")):
        if number == MAX_ROWS:
            raise RecordingError(file, f"table {table}", "endless rows", f"at most {MAX_ROWS}")
        yield row


def _chosen(
    rows: list[tuple[int, ConfirmedReading]], attempts: dict[int, bool], cell: Cell
) -> tuple[list[ConfirmedReading], list[Note]]:
    """Return the readings that count, in the order of time, and what has to be said of the others."""
    tried: dict[int, dict[int, list[ConfirmedReading]]] = {}
    for attempt, reading in rows:
        # each visit to the reference configuration, number 0, is an attempt of its own, and all of them count
        number = attempt if reading.configuration else 0
        tried.setdefault(reading.configuration, {}).setdefault(number, []).append(reading)
    chosen: list[ConfirmedReading] = []
    notes: list[Note] = []
    for configuration, mine in tried.items():
        best = max(mine, key=lambda number: (attempts.get(number, False), len(mine[number]), number))
        chosen += mine[best]
        place, steps = f"configuration {configuration}", len({one.step for one in mine[best]})
        if len(mine) > 1:
            text = f"measured {len(mine)} times: the attempt with {steps} steps is used"
            notes.append(Note("repeated", place, text, len(mine) - 1))
        if configuration and not attempts[best]:
            notes.append(Note("interrupted", place, f"not measured to its end: the {steps} steps confirmed are used"))
    order = {name: index for index, name in enumerate(cell.points)}
    return sorted(chosen, key=lambda one: (one.time, one.configuration, one.step, order[one.point])), notes


def _reported(file: Path, database: sqlite3.Connection) -> list[Note]:
    """Return which points an operator has left out of which configuration, and what was last known of the clock."""
    events = [(kind, *str(text).partition(" ")[::2]) for kind, text in _limited(file, database, "event", "kind, text")]
    clocks = [tracker_clock(text) for kind, _, text in events if kind == CLOCK]
    return [point_excluded(p.partition(".")[0], text) for kind, p, text in events if kind == EXCLUDED] + clocks[-1:]


def _conditions(file: Path, database: sqlite3.Connection) -> tuple[tuple[Condition, ...], ...]:
    found: list[tuple[Condition, ...]] = []
    size = 0
    for (text,) in _limited(file, database, "condition", "content"):
        size += len(text) if isinstance(text, str) else 0
        if size > MAX_CONDITIONS:
            raise RecordingError(file, "table condition", "endless conditions", f"at most {MAX_CONDITIONS} bytes")
        found.append(tuple(_condition(file, one) for one in _listed(_json(file, "condition.content", text))))
    return tuple(found)


def _listed(value: object) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _condition(file: Path, row: Any) -> Condition:
    words = ("name", "clause", "requirement", "limit", "value")
    given = row.get("override") if isinstance(row, dict) else None
    if (
        not isinstance(row, dict)
        or not all(isinstance(row.get(word), str) for word in words)
        or row.get("met") not in VERDICTS
        or not (given is None or (isinstance(given, dict) and set(given) == {"condition", "operator", "reason"}))
    ):
        raise RecordingError(file, "table condition", quoted(row), "conditions as the sequencer writes them")
    override = None if given is None else Override(*(str(given[key]) for key in ("condition", "operator", "reason")))
    name, clause, requirement, limit, value = (row[word] for word in words)
    return Condition(name, clause, requirement, limit, value, row["met"], bool(row.get("shall")), override)


def _json(file: Path, place: str, text: object) -> Any:
    """Parse JSON that may say anything; numbers that are not finite are none."""
    if not isinstance(text, str):
        raise RecordingError(file, place, quoted(text), "text (JSON)")
    try:
        return json.loads(text, parse_constant=_refused, parse_float=_finite)
    except (ValueError, RecursionError):
        raise RecordingError(file, place, quoted(text), "JSON with finite numbers") from None


def _refused(name: str) -> float:
    raise ValueError(name)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value
