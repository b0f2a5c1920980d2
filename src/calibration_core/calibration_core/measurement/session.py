"""A calibration session on disk: what was planned, what was measured, what the guard decided, with which software.

A session is a directory: `plan.yaml` as it was when the session began, `session.db` with everything that happened,
and the bags.  The database is SQLite in WAL mode with `synchronous = FULL`: the rows of one step are one transaction,
which is on the disk when `record` returns, so that a reading is confirmed only when nothing but the loss of the disk
can take it away; a process killed in between leaves either all rows of a step or none, and other processes read while
one writes.  An append-only file would need its own record format, checksums and repair to give the same.  WAL needs a
local disk, as bags do.

A configuration may be attempted several times.  Rows carry the number of their attempt, and nothing is deleted; the
rows that count are those of attempts that were completed, and of the reference configuration.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import hashlib
import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Self

from calibration_core.cell import Cell
from calibration_core.errors import SessionError, SessionGoneError, storage_fault
from calibration_core.planning.plans.plan import REFERENCE_NUMBER
from calibration_core.recording.session_values import ConfirmedReading, Decision, Event, packed, unpacked
from calibration_core.recording.source import SESSION_DATABASE
from calibration_core.timeseries import Condition, Override

SCHEMA = 1
DATABASE, PLAN, LOCK = SESSION_DATABASE, "plan.yaml", "session.lock"
PLACE = "attempt, configuration, step, point, time"
WRITABLE = "a directory to write to"
PATIENCE = 5.0  # s, waiting for another process's transaction

TABLES = """
CREATE TABLE session (schema INTEGER NOT NULL, plan_sha256 TEXT NOT NULL, cell_sha256 TEXT NOT NULL,
  robot TEXT NOT NULL, points TEXT NOT NULL);
CREATE TABLE run (id INTEGER PRIMARY KEY, time INTEGER NOT NULL, provenance TEXT NOT NULL);
CREATE TABLE attempt (id INTEGER PRIMARY KEY, configuration INTEGER NOT NULL, time INTEGER NOT NULL,
  outcome TEXT NOT NULL DEFAULT 'open', reason TEXT NOT NULL DEFAULT '');
CREATE TABLE reading (id INTEGER PRIMARY KEY, attempt INTEGER NOT NULL REFERENCES attempt(id),
  configuration INTEGER NOT NULL, step INTEGER NOT NULL, point TEXT NOT NULL, time INTEGER NOT NULL,
  content TEXT NOT NULL, UNIQUE (attempt, configuration, step, point));
CREATE TABLE decision (id INTEGER PRIMARY KEY, time INTEGER NOT NULL, permitted INTEGER NOT NULL,
  latched INTEGER NOT NULL, reasons TEXT NOT NULL);
CREATE TABLE event (id INTEGER PRIMARY KEY, time INTEGER NOT NULL, kind TEXT NOT NULL, text TEXT NOT NULL);
"""
LATER = """
CREATE TABLE IF NOT EXISTS condition (id INTEGER PRIMARY KEY, time INTEGER NOT NULL, content TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS override (id INTEGER PRIMARY KEY, time INTEGER NOT NULL, condition TEXT NOT NULL,
  operator TEXT NOT NULL, reason TEXT NOT NULL);
"""  # sessions begun by earlier versions get them when they are resumed


class Session:
    """The store of one session; `create` or `resume` it to write, `look` at it to read."""

    def __init__(self, directory: Path, database: sqlite3.Connection, lock: IO[str] | None) -> None:
        self.directory = directory
        self._database = database
        self._lock = lock
        self._files = (directory / DATABASE, directory / f"{DATABASE}-wal")
        # They follow files that are moved.  To close a handle that can read would give SQLite's locks free.
        self._held = [os.open(file, os.O_PATH) for file in self._files if lock is not None]
        self._left = [_state(os.fstat(file)) for file in self._held]

    # --- opening -----------------------------------------------------------------------------------------------------

    @classmethod
    def create(cls, directory: Path, plan_text: str, cell: Cell) -> Self:
        """Begin a session in a directory that holds none yet.

        Raises:
            SessionError: There is a session already, or the directory cannot be written to.
        """
        lock = _locked(directory)
        if (directory / DATABASE).exists():
            lock.close()
            raise SessionError(directory, "", "a session", "an empty directory, or to resume this session")
        # under another name until it is whole: a process killed here leaves no half-made session
        unfinished = directory / f".{DATABASE}"
        try:
            write_durably(directory / PLAN, plan_text)
            unfinished.unlink(missing_ok=True)
            with contextlib.closing(sqlite3.connect(unfinished, isolation_level=None)) as database:
                database.executescript(f"PRAGMA synchronous = FULL; BEGIN; {TABLES} {LATER} COMMIT;")
                row = (SCHEMA, _digest(plan_text), cell.sha256, cell.robot.name, json.dumps(cell.points))
                database.execute("INSERT INTO session VALUES (?, ?, ?, ?, ?)", row)
            unfinished.rename(directory / DATABASE)
            sync_directory(directory)
        except (OSError, sqlite3.OperationalError) as error:
            lock.close()
            raise SessionError(directory, "", *storage_fault(directory, error, WRITABLE)) from None
        return cls(directory, _connect(directory), lock)

    @classmethod
    def resume(cls, directory: Path, plan_text: str, cell: Cell) -> Self:
        """Open a session to go on with it; attempts that were under way count as interrupted.

        Raises:
            SessionError: There is none, it is damaged or in use by a process, or plan or cell have changed since.
        """
        _expect(directory)
        lock = _locked(directory)
        try:
            session = cls(directory, _connect(directory), lock)
            known = session._one("SELECT plan_sha256, cell_sha256 FROM session")
            for name, old, new in (("plan", known[0], _digest(plan_text)), ("cell", known[1], cell.sha256)):
                if old != new:
                    raise SessionError(directory, name, f"one with SHA-256 {new[:12]}…", f"the session's, {old[:12]}…")
        except SessionError:
            lock.close()
            raise
        with session._transaction():
            for table in filter(str.strip, LATER.split(";")):
                session._database.execute(table)
            session._database.execute("UPDATE attempt SET outcome = 'interrupted' WHERE outcome = 'open'")
        return session

    @classmethod
    def look(cls, directory: Path) -> Self:
        """Open a session to read it, whether or not another process is writing to it.

        Raises:
            SessionError: There is none, or it is damaged.
        """
        _expect(directory)
        return cls(directory, _connect(directory), None)

    def close(self) -> None:
        """Close the database and let others write."""
        self._database.close()
        while self._held:
            os.close(self._held.pop())
        if self._lock is not None:
            self._lock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- writing -----------------------------------------------------------------------------------------------------

    def begin_run(self, time: int, provenance: Mapping[str, str]) -> None:
        """Note that the procedure was started at `time` (ns), with these versions and parameters."""
        text = json.dumps(dict(provenance), sort_keys=True)
        self._insert("INSERT INTO run (time, provenance) VALUES (?, ?)", (time, text))

    def begin_attempt(self, configuration: int, time: int) -> int:
        """Note that a configuration is approached at `time` (ns); return the number of this attempt."""
        return self._insert("INSERT INTO attempt (configuration, time) VALUES (?, ?)", (configuration, time))

    def record(self, attempt: int, readings: Sequence[ConfirmedReading]) -> None:
        """Store the readings of one step; when this returns, they are on the disk.

        Raises:
            SessionError: One of them is there already.
        """
        rows = [(attempt, r.configuration, r.step, r.point, r.time, packed(r)) for r in readings]
        try:
            with self._transaction():
                self._database.executemany(f"INSERT INTO reading ({PLACE}, content) VALUES (?, ?, ?, ?, ?, ?)", rows)
        except sqlite3.IntegrityError as error:
            raise SessionError(self.directory, f"attempt {attempt}", str(error), "every reading once") from None

    def end_attempt(self, attempt: int, *, completed: bool, reason: str = "") -> None:
        """Note that an attempt is over: completed, or given up for a reason."""
        outcome = "completed" if completed else "given up"
        self._insert("UPDATE attempt SET outcome = ?, reason = ? WHERE id = ?", (outcome, reason, attempt))

    def decide(self, decision: Decision) -> None:
        """Store a change of the guard's mind."""
        row = (decision.time, decision.permitted, decision.latched, json.dumps(decision.reasons))
        self._insert("INSERT INTO decision (time, permitted, latched, reasons) VALUES (?, ?, ?, ?)", row)

    def note(self, event: Event) -> None:
        """Store an event."""
        self._insert("INSERT INTO event (time, kind, text) VALUES (?, ?, ?)", (event.time, event.kind, event.text))

    def judge(self, time: int, conditions: Sequence[Condition]) -> None:
        """Store how the standard's conditions stand at `time` (ns)."""
        text = json.dumps([dataclasses.asdict(one) for one in conditions])
        self._insert("INSERT INTO condition (time, content) VALUES (?, ?)", (time, text))

    def override(self, time: int, override: Override) -> None:
        """Store who lets the measurement go on in spite of a condition, from `time` (ns)."""
        row = (time, override.condition, override.operator, override.reason)
        self._insert("INSERT INTO override (time, condition, operator, reason) VALUES (?, ?, ?, ?)", row)

    # --- reading -----------------------------------------------------------------------------------------------------

    @property
    def plan_text(self) -> str:
        """Content of the plan file as it was when the session began."""
        return (self.directory / PLAN).read_text(encoding="utf-8")

    @property
    def plan_sha256(self) -> str:
        """SHA-256 of that text."""
        return str(self._one("SELECT plan_sha256 FROM session")[0])

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the measurement points."""
        return tuple(json.loads(self._one("SELECT points FROM session")[0]))

    @property
    def runs(self) -> tuple[Mapping[str, str], ...]:
        """Provenance of every start of the procedure."""
        return tuple(json.loads(row[0]) for row in self._all("SELECT provenance FROM run ORDER BY id"))

    @property
    def completed(self) -> tuple[int, ...]:
        """Numbers of the configurations measured completely, in the order of time; without the reference."""
        rows = self._all(
            "SELECT configuration FROM attempt WHERE outcome = 'completed' AND configuration != ? ORDER BY id",
            (REFERENCE_NUMBER,),
        )
        return tuple(dict.fromkeys(row[0] for row in rows))

    @property
    def attempts(self) -> tuple[tuple[int, int, str, str], ...]:
        """Attempt, configuration, outcome (open, completed, given up, interrupted) and reason, in the order of time."""
        rows = self._all("SELECT id, configuration, outcome, reason FROM attempt ORDER BY id")
        return tuple((int(row[0]), int(row[1]), str(row[2]), str(row[3])) for row in rows)

    def given_up(self, attempts: int) -> frozenset[int]:
        """Return the configurations that were given up so many times, and never measured."""
        tried: dict[int, int] = {}
        for _, configuration, outcome, _ in self.attempts:
            if outcome == "given up":
                tried[configuration] = tried.get(configuration, 0) + 1
        return frozenset(number for number, count in tried.items() if count >= attempts) - frozenset(self.completed)

    @property
    def reference_visits(self) -> int:
        """How often the reference configuration has been recorded; the step number of the next visit."""
        row = self._one("SELECT COALESCE(MAX(step) + 1, 0) FROM reading WHERE configuration = ?", (REFERENCE_NUMBER,))
        return int(row[0])

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """What the guard decided, in the order of time."""
        rows = self._all("SELECT time, permitted, latched, reasons FROM decision ORDER BY id")
        return tuple(Decision(row[0], bool(row[1]), bool(row[2]), tuple(json.loads(row[3]))) for row in rows)

    @property
    def events(self) -> tuple[Event, ...]:
        """What happened, in the order of time."""
        return tuple(Event(*row) for row in self._all("SELECT time, kind, text FROM event ORDER BY id"))

    @property
    def overrides(self) -> tuple[Override, ...]:
        """Which conditions are overridden by whom, in the order of time."""
        return tuple(Override(*row) for row in self._later("SELECT condition, operator, reason FROM override"))

    @property
    def conditions(self) -> tuple[tuple[Condition, ...], ...]:
        """How the standard's conditions stood: every change, in the order of time."""
        return tuple(_conditions(row[0]) for row in self._later("SELECT content FROM condition"))

    def confirmed(self, *, all_attempts: bool = False) -> tuple[ConfirmedReading, ...]:
        """Return the readings in the order of time.

        Args:
            all_attempts: Also those of attempts that were not completed.
        """
        rows = self._all(
            "SELECT r.configuration, r.step, r.point, r.time, r.content FROM reading r"
            " JOIN attempt a ON a.id = r.attempt"
            " WHERE ? OR a.outcome = 'completed' OR r.configuration = ? ORDER BY r.id",
            (all_attempts, REFERENCE_NUMBER),
        )
        return tuple(unpacked(*row) for row in rows)

    @property
    def identity(self) -> str:
        """The session's directory and when its first run began, ns: as readings carry it."""
        return f"{self.directory.absolute()}@{self._one('SELECT COALESCE(MIN(time), 0) FROM run')[0]}"

    def fault(self) -> str:
        """Say that its database is not as this process has left it: moved, deleted or written by others; else empty."""
        found = []
        for file in self._files:
            with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                found.append(_state(file.stat()))
        if found == self._left:
            return ""
        gone = not (self.directory / DATABASE).is_file()
        what = "is gone" if gone else "was changed by another program"
        return f"{self.directory / DATABASE} {what}: put it back as it was, or begin a new session"

    # --- the database ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        if self._lock is None:
            raise SessionError(self.directory, "", "a session opened to be read", "one created or resumed")
        if wrong := self.fault():
            raise SessionGoneError(self.directory, "", wrong, "the database as it was left")
        try:
            self._database.execute("BEGIN IMMEDIATE")
            yield
            self._database.execute("COMMIT")
        except sqlite3.IntegrityError:
            raise
        except sqlite3.DatabaseError as error:
            file = self.directory / DATABASE
            raise SessionError(file, "", *storage_fault(file, error, "a database that can be written")) from None
        finally:
            if self._database.in_transaction:  # not committed: SQLite itself may have rolled back already
                self._database.execute("ROLLBACK")
            self._left = [_state(os.fstat(file)) for file in self._held]

    def _insert(self, statement: str, row: tuple[object, ...]) -> int:
        with self._transaction():
            return int(self._database.execute(statement, row).lastrowid or 0)

    def _all(self, statement: str, row: tuple[object, ...] = ()) -> list[tuple[Any, ...]]:
        return self._database.execute(statement, row).fetchall()

    def _later(self, statement: str) -> list[tuple[Any, ...]]:
        """Read from a table that sessions of earlier versions do not have."""
        there = self._one("SELECT COUNT(*) FROM sqlite_master WHERE name = 'condition'")[0]
        return self._all(f"{statement} ORDER BY id") if there else []

    def _one(self, statement: str, row: tuple[object, ...] = ()) -> tuple[Any, ...]:
        return self._all(statement, row)[0]


def _state(of: os.stat_result) -> tuple[int, int, int, int]:
    """Return what tells whether somebody else has touched a file."""
    return of.st_dev, of.st_ino, of.st_size, of.st_mtime_ns


def _conditions(text: str) -> tuple[Condition, ...]:
    rows = json.loads(text)
    for row in rows:
        row["override"] = None if row["override"] is None else Override(**row["override"])
    return tuple(Condition(**row) for row in rows)


def _connect(directory: Path) -> sqlite3.Connection:
    database = sqlite3.connect(directory / DATABASE, timeout=PATIENCE, isolation_level=None, check_same_thread=False)
    try:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = FULL")
        found = database.execute("SELECT schema FROM session").fetchall()
    except sqlite3.DatabaseError as error:
        database.close()
        raise SessionError(directory, DATABASE, str(error), "a session's database") from None
    if found != [(SCHEMA,)]:
        database.close()
        raise SessionError(directory, DATABASE, f"schema {found}", f"[({SCHEMA},)]")
    return database


def _expect(directory: Path) -> None:
    if not (directory / DATABASE).is_file():
        raise SessionError(directory, "", f"no {DATABASE}", "a session's directory")


def _locked(directory: Path) -> IO[str]:
    """Take the directory for this process; the system gives it free when the process ends, however that happens."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        lock = (directory / LOCK).open("w", encoding="utf-8")
    except OSError as error:
        raise SessionError(directory, "", *storage_fault(directory, error, WRITABLE)) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.close()
        raise SessionError(directory, "", "a session in use by another process", "one that nobody writes to") from None
    return lock


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def write_durably(path: Path, text: str) -> None:
    """Write a file; when this returns, its content is on the disk."""
    with path.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def sync_directory(directory: Path) -> None:
    """Bring the names in a directory onto the disk."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
