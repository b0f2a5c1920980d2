from __future__ import annotations

import contextlib
import errno
import math
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import SessionError, SessionGoneError
from calibration_core.measurement.session import DATABASE, PLAN, Session
from calibration_core.recording.session_values import ConfirmedReading, Decision, Event, as_readings

ROOT = Path(__file__).parents[4]
PLAN_TEXT = "schema: 1\n"


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell(ROOT / "config" / "cells" / "demo.cell.yaml")


def reading(configuration: int, step: int, point: str = "mp1", **changes: object) -> ConfirmedReading:
    rng = np.random.default_rng([configuration, step, sum(point.encode())])
    values = {
        "time": 10**18 + 7_000_000_001 * step,
        "q": rng.normal(size=6),
        "position": rng.normal(size=3),
        "position_covariance": np.diag(rng.uniform(size=3)) / 3.0,
        "samples": 20,
        "wrench": rng.normal(size=6),
        "wrench_covariance": np.eye(6) / 7.0,
        "temperature": 20.1,
    } | changes
    return ConfirmedReading(configuration, step, point, **values)


def assert_same(a: ConfirmedReading, b: ConfirmedReading) -> None:
    assert (a.configuration, a.step, a.point, a.time, a.samples) == (
        b.configuration,
        b.step,
        b.point,
        b.time,
        b.samples,
    )
    for name in ("q", "position", "position_covariance", "wrench", "wrench_covariance", "temperature"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_what_was_recorded_is_read_back_to_the_bit(tmp_path: Path, cell: Cell) -> None:
    bare = reading(3, 1, wrench=None, wrench_covariance=None, temperature=math.nan)
    with Session.create(tmp_path / "s", PLAN_TEXT, cell) as session:
        attempt = session.begin_attempt(3, 1)
        session.record(attempt, [reading(3, 0, name) for name in cell.points])
        session.record(attempt, [bare])
        session.end_attempt(attempt, completed=True)
    with Session.look(tmp_path / "s") as session:
        found = session.confirmed()
        assert session.points == cell.points
        assert session.plan_text == PLAN_TEXT
    for was, now in zip([*(reading(3, 0, name) for name in cell.points), bare], found, strict=True):
        assert_same(was, now)


def test_only_completed_attempts_and_the_reference_count(tmp_path: Path, cell: Cell) -> None:
    with Session.create(tmp_path, PLAN_TEXT, cell) as session:
        first = session.begin_attempt(1, 1)
        session.record(first, [reading(1, 0)])
        session.end_attempt(first, completed=False, reason="blocked")
        second = session.begin_attempt(1, 2)
        session.record(second, [reading(1, 0), reading(1, 0, "mp2")])
        session.end_attempt(second, completed=True)
        reference = session.begin_attempt(0, 3)
        assert session.reference_visits == 0
        session.record(reference, [reading(0, 0)])
        assert session.reference_visits == 1
        under_way = session.begin_attempt(2, 4)
        session.record(under_way, [reading(2, 0)])
        assert session.completed == (1,)
        assert [(r.configuration, r.point) for r in session.confirmed()] == [(1, "mp1"), (1, "mp2"), (0, "mp1")]
        assert len(session.confirmed(all_attempts=True)) == 5
        assert [outcome for _, _, outcome, _ in session.attempts] == ["given up", "completed", "open", "open"]
        assert session.attempts[0][3] == "blocked"
    with Session.resume(tmp_path, PLAN_TEXT, cell) as session:
        assert [outcome for _, _, outcome, _ in session.attempts][-1] == "interrupted"
        again = session.begin_attempt(2, 5)
        session.record(again, [reading(2, 0)])
        session.end_attempt(again, completed=True)
        assert session.completed == (1, 2)


def test_readings_for_the_identification(tmp_path: Path, cell: Cell) -> None:
    rows = [reading(4, step, name) for step in range(2) for name in cell.points]
    readings = as_readings(rows, cell.points, str(tmp_path))
    assert readings.points == cell.points
    assert readings.configuration.tolist() == [4] * 6
    assert readings.step.tolist() == [0, 0, 0, 1, 1, 1]
    assert readings.point.tolist() == [0, 1, 2, 0, 1, 2]
    assert readings.time.tolist() == pytest.approx([0, 0, 0, 7.000000001, 7.000000001, 7.000000001])
    np.testing.assert_array_equal(readings.position[4], rows[4].position)
    assert readings.wrench is not None
    assert as_readings([reading(1, 0, wrench=None)], cell.points, "").wrench is None


def test_decisions_events_and_runs_are_kept(tmp_path: Path, cell: Cell) -> None:
    decisions = [Decision(5, False, True, ("over speed", "drives off")), Decision(6, True, False, ())]
    with Session.create(tmp_path, PLAN_TEXT, cell) as session:
        session.begin_run(1, {"version": "0.1.0", "cell": cell.sha256})
        for decision in decisions:
            session.decide(decision)
        session.note(Event(7, "tare", "bias (1, 2, 3) N"))
    with Session.resume(tmp_path, PLAN_TEXT, cell) as session:
        session.begin_run(8, {"version": "0.1.1"})
        assert list(session.decisions) == decisions
        assert session.events == (Event(7, "tare", "bias (1, 2, 3) N"),)
        assert [run["version"] for run in session.runs] == ["0.1.0", "0.1.1"]


def test_the_same_reading_twice_is_refused_as_a_whole(tmp_path: Path, cell: Cell) -> None:
    with Session.create(tmp_path, PLAN_TEXT, cell) as session:
        attempt = session.begin_attempt(1, 1)
        session.record(attempt, [reading(1, 0)])
        with pytest.raises(SessionError, match="every reading once"):
            session.record(attempt, [reading(1, 0, "mp2"), reading(1, 0)])
        assert [r.point for r in session.confirmed(all_attempts=True)] == ["mp1"]


def test_one_writer_many_readers(tmp_path: Path, cell: Cell) -> None:
    with Session.create(tmp_path, PLAN_TEXT, cell) as session, Session.look(tmp_path) as reader:
        for opening in (Session.create, Session.resume):
            with pytest.raises(SessionError, match="in use"):
                opening(tmp_path, PLAN_TEXT, cell)
        session.record(session.begin_attempt(0, 1), [reading(0, 0)])
        assert len(reader.confirmed()) == 1
        with pytest.raises(SessionError, match="opened to be read"):
            reader.note(Event(1, "x", "y"))


def test_refusals(tmp_path: Path, cell: Cell) -> None:
    with pytest.raises(SessionError, match=r"no session\.db"):
        Session.look(tmp_path)
    with pytest.raises(SessionError, match=r"no session\.db"):
        Session.resume(tmp_path, PLAN_TEXT, cell)
    Session.create(tmp_path, PLAN_TEXT, cell).close()
    with pytest.raises(SessionError, match="found a session"):
        Session.create(tmp_path, PLAN_TEXT, cell)
    with pytest.raises(SessionError, match="plan"):
        Session.resume(tmp_path, PLAN_TEXT + " ", cell)
    with pytest.raises(SessionError, match="cell"):
        Session.resume(tmp_path, PLAN_TEXT, cell.model_copy(update={"sha256": "0" * 64}))
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionError, match="a directory"):
        Session.create(tmp_path / "file", PLAN_TEXT, cell)


@pytest.mark.parametrize("damage", [b"", b"no database at all, but long enough to be read as a header" * 100])
def test_a_damaged_database_is_named(tmp_path: Path, cell: Cell, damage: bytes) -> None:
    (tmp_path / DATABASE).write_bytes(damage)
    with pytest.raises(SessionError, match=r"session\.db"):
        Session.look(tmp_path)
    with pytest.raises(SessionError, match=r"session\.db"):
        Session.resume(tmp_path, PLAN_TEXT, cell)


def test_a_session_cut_off_while_it_was_created_leaves_none(tmp_path: Path, cell: Cell) -> None:
    (tmp_path / PLAN).write_text(PLAN_TEXT)
    (tmp_path / f".{DATABASE}").write_bytes(b"half")
    Session.create(tmp_path, PLAN_TEXT, cell).close()
    with contextlib.closing(sqlite3.connect(tmp_path / DATABASE)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)


WRITER = """
import sys
from pathlib import Path
import numpy as np
from calibration_core.cell import load_cell
from calibration_core.measurement.session import Session, DATABASE
from calibration_core.recording.session_values import ConfirmedReading
directory, cell = Path(sys.argv[1]), load_cell(sys.argv[2])
opening = Session.resume if (directory / DATABASE).exists() else Session.create
with opening(directory, "schema: 1\\n", cell) as session:
    number = 1 + max(session.completed, default=0)
    while True:
        attempt = session.begin_attempt(number, 1)
        for step in range(4):
            rows = [
                ConfirmedReading(number, step, name, number, np.zeros(6), np.full(3, number), np.eye(3), 1)
                for name in cell.points
            ]
            session.record(attempt, rows)
            print(number, attempt, step, flush=True)
        session.end_attempt(attempt, completed=True)
        print(number, flush=True)
        number += 1
"""


@pytest.mark.parametrize("kills", [5, pytest.param(30, marks=pytest.mark.slow)])
def test_kill_9_at_any_moment_loses_nothing_confirmed(tmp_path: Path, cell: Cell, kills: int) -> None:
    rng = random.Random(kills)
    confirmed: set[tuple[int, ...]] = set()
    for _ in range(kills):
        process = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(WRITER), tmp_path, cell.path], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        first = process.stdout.readline()
        time.sleep(rng.uniform(0.0, 0.05))
        process.send_signal(signal.SIGKILL)
        said = [first, *process.stdout]
        process.wait()
        process.stdout.close()
        confirmed |= {tuple(map(int, line.split())) for line in said if line.endswith("\n")}
        with Session.look(tmp_path) as session:
            rows = session.confirmed(all_attempts=True)
            per_step = {}
            for row in rows:
                per_step.setdefault((row.configuration, row.time, row.step), []).append(row.point)
            completed = session.completed
            attempts = {number: configuration for number, configuration, _, _ in session.attempts}
        assert {line[0] for line in confirmed if len(line) == 1} <= set(completed)
        steps = {(line[0], line[2]) for line in confirmed if len(line) == 3}
        assert steps <= {(configuration, step) for configuration, _, step in per_step}
        assert all(len(names) % len(cell.points) == 0 for names in per_step.values())  # all points of a step, or none
        assert all(attempts[line[1]] == line[0] for line in confirmed if len(line) == 3)
    assert len(confirmed) > kills
    with contextlib.closing(sqlite3.connect(tmp_path / DATABASE)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.parametrize("there", [False, True], ids=["created", "resumed"])
def test_a_file_system_that_cannot_be_written_is_named(
    tmp_path: Path, cell: Cell, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    directory = tmp_path / "session"
    if there:
        Session.create(directory, PLAN_TEXT, cell).close()

    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(directory))

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(SessionError) as error:
        (Session.resume if there else Session.create)(directory, PLAN_TEXT, cell)
    assert str(error.value) == f"{directory}: found Read-only file system, expected a directory to write to"


@pytest.mark.parametrize("how", ["deleted", "its directory deleted", "replaced", "written over", "log deleted"])
def test_a_database_that_others_touch_is_told_before_the_next_row(tmp_path: Path, cell: Cell, how: str) -> None:
    """Rows that went into a file that nobody finds again would count for nothing."""
    file = tmp_path / "s" / DATABASE
    with Session.create(tmp_path / "s", PLAN_TEXT, cell) as session:
        attempt = session.begin_attempt(1, 0)
        session.record(attempt, [reading(1, 0)])
        with Session.look(tmp_path / "s") as other:
            assert len(other.confirmed(all_attempts=True)) == 1
        assert session.fault() == ""
        match how:
            case "deleted":
                file.unlink()
            case "its directory deleted":
                shutil.rmtree(tmp_path / "s")
            case "replaced":
                (tmp_path / "other").write_bytes(file.read_bytes())
                (tmp_path / "other").replace(file)
            case "written over":
                file.write_bytes(b"nothing of a session" * 1000)
            case _:
                (tmp_path / "s" / f"{DATABASE}-wal").unlink()
        assert str(file) in session.fault()
        with pytest.raises(SessionError, match=r"is gone|was changed by another program"):
            session.record(attempt, [reading(1, 1)])


@pytest.mark.parametrize("moved", ["BEGIN IMMEDIATE", "COMMIT", ""])
def test_a_session_that_was_moved_and_put_back_goes_on(tmp_path: Path, cell: Cell, moved: str) -> None:
    """Also where it is moved while a row is written, which is in the file that comes back."""
    there, elsewhere = tmp_path / "s", tmp_path / "elsewhere"

    def leave(statement: str) -> None:
        if statement == moved:
            there.rename(elsewhere)

    with Session.create(there, PLAN_TEXT, cell) as session:
        attempt = session.begin_attempt(1, 0)
        session._database.set_trace_callback(leave)
        session.record(attempt, [reading(1, 0)])
        leave("")
        assert "is gone" in session.fault()
        with pytest.raises(SessionGoneError):
            session.record(attempt, [reading(1, 1)])
        elsewhere.rename(there)
        assert session.fault() == ""
        session._database.set_trace_callback(None)
        session.record(attempt, [reading(1, 1)])
        assert len(session.confirmed(all_attempts=True)) == 2


def test_a_session_has_an_identity_of_its_own(tmp_path: Path, cell: Cell) -> None:
    with Session.create(tmp_path / "s", PLAN_TEXT, cell) as session:
        session.begin_run(7, {})
        first = session.identity
    with Session.resume(tmp_path / "s", PLAN_TEXT, cell) as session:
        session.begin_run(9, {})
        assert session.identity == first == f"{tmp_path / 's'}@7"
