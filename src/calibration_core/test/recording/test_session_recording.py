"""A session as a recording: what was confirmed is never stranded, and a hostile database gets one line."""

from __future__ import annotations

import contextlib
import json
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.errors import RecordingError
from calibration_core.measurement.session import DATABASE, Session
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.observations.observe import observe
from calibration_core.planning.plans.plan import PlannedConfiguration
from calibration_core.recording.session_values import ConfirmedReading, Event
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import Condition, Override, Readings

ROOT = Path(__file__).parents[4]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
PLAN_TEXT = "schema: 1\n"
START = 1_700_000_000 * 10**9


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell(CELL)


@pytest.fixture(scope="module")
def measured(cell: Cell) -> Readings:
    """14 configurations with two load steps, as the cell's model predicts them, with noise."""
    rng = np.random.default_rng(4)
    steps = np.zeros((2, 6))
    steps[1, :3] = (300.0, -200.0, -2000.0)
    q = rng.uniform(-0.9, 0.9, (14, 6)) + np.array([0.0, 0.2, 0.3, 0.0, 0.7, 0.0])
    plan = [PlannedConfiguration(number, row, steps) for number, row in enumerate(q, start=1)]
    return simulate_plan(plan, cell, nominal_parameters(cell), seed=1)


def confirmed(readings: Readings) -> dict[tuple[int, int], list[ConfirmedReading]]:
    """Sort readings by configuration and step."""
    found: dict[tuple[int, int], list[ConfirmedReading]] = {}
    for i in range(len(readings)):
        assert readings.wrench is not None
        place = int(readings.configuration[i]), int(readings.step[i])
        one = ConfirmedReading(
            *place, readings.points[int(readings.point[i])], START + 10**9 * i, readings.q[i], readings.position[i],
            4e-10 * np.eye(3), 20, readings.wrench[i], np.eye(6), 20.5,
        )  # fmt: skip
        found.setdefault(place, []).append(one)
    return found


@pytest.fixture(scope="module")
def whole(cell: Cell, measured: Readings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session in which everything was measured at the first attempt."""
    directory = tmp_path_factory.mktemp("session") / "today"
    with Session.create(directory, PLAN_TEXT, cell) as session:
        rows = confirmed(measured)
        for number in sorted({place[0] for place in rows}):
            attempt = session.begin_attempt(number, 0)
            for place in sorted(rows):
                if place[0] == number:
                    session.record(attempt, rows[place])
            session.end_attempt(attempt, completed=True)
        condition = Condition("temperature", "5.1", "20 C", "2 K", "25 C", met=False, shall=True)
        session.judge(0, [condition])
        session.override(1, Override("temperature", "A. Smith", "no cooling"))
    return directory


def test_a_session_is_what_it_confirmed(whole: Path, cell: Cell, measured: Readings) -> None:
    for path in (whole, whole / DATABASE):
        found = observe(path, cell)
        for name in ("configuration", "step", "point", "q", "position", "wrench"):
            np.testing.assert_array_equal(getattr(found, name), getattr(measured, name))
        assert found.provenance.kind == "session"
        assert found.provenance.start == "2023-11-14T22:13:20+00:00"
        with Session.look(whole) as session:
            assert found.provenance.plan_sha256 == session.plan_sha256
        assert set(found.provenance.sha256) >= {DATABASE}
        assert [(one.name, one.met) for one in found.conditions] == [("temperature", False)]
        assert found.notes == ()


def test_session_and_table_of_the_same_readings_give_the_same_stiffness(
    whole: Path, measured: Readings, tmp_path: Path
) -> None:
    """The claims of the instruments are the same; a session adds what the samples scattered."""
    write_table(tmp_path / "table.csv", measured)
    results = []
    for name, recording in (("session", whole), ("database", whole / DATABASE), ("table", tmp_path / "table.csv")):
        out = tmp_path / name
        assert main(["identify", str(recording), "--cell", str(CELL), "--out", str(out), "--no-report"]) == 0
        results.append(json.loads((out / "result.json").read_text())["stiffness"])
    assert results[0] == results[1]
    values = np.array([[joint["value"] for joint in result] for result in results])
    np.testing.assert_allclose(values[0], values[2], rtol=1e-3)


def test_points_that_an_operator_left_out_are_told_and_cost_their_readings_alone(
    whole: Path, cell: Cell, measured: Readings, tmp_path: Path
) -> None:
    rows = confirmed(measured)
    with Session.create(tmp_path / "today", PLAN_TEXT, cell) as session:
        for number in sorted({place[0] for place in rows}):
            attempt = session.begin_attempt(number, 0)
            for place in sorted(one for one in rows if one[0] == number):
                # of configuration 3 one point is missing, of 5 another one from the load on
                left_out = {3: "mp2", 5: "mp1" if place[1] else ""}.get(number)
                session.record(attempt, [one for one in rows[place] if one.point != left_out])
            session.end_attempt(attempt, completed=True)
        session.note(Event(0, "point_excluded", "3.0 mp2 by A. Smith: the cable hides it"))
        session.note(Event(0, "point_excluded", "5.1 mp1 by A. Smith: knocked"))
        session.note(Event(0, "tracker_clock", "tracker: the tracker's clock is 5.5 s ahead"))
        session.note(Event(0, "tracker_clock", "tracker: the tracker's clock is 5.6 s ahead"))
        session.note(Event(0, "started", "0.0 "))
    results = []
    for recording in (whole, tmp_path / "today"):
        out = tmp_path / f"out {len(results)}"
        assert main(["identify", str(recording), "--cell", str(CELL), "--out", str(out)]) == 0
        results.append(json.loads((out / "result.json").read_text()))
    reported = [(one["place"], one["text"]) for one in results[1]["notes"] if one["kind"] == "point_excluded"]
    assert reported == [
        ("configuration 3", "mp2 by A. Smith: the cable hides it"),
        ("configuration 5", "mp1 by A. Smith: knocked"),
    ]
    (clock,) = [one["text"] for one in results[1]["notes"] if one["kind"] == "tracker_clock"]
    assert clock == "the tracker's clock is 5.6 s ahead; its stamps are corrected"
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "mp2 by A. Smith: the cable hides it" in report
    assert "clock is 5.6 s ahead; its stamps are corrected" in report
    assert results[1]["recording"]["configurations"] == results[0]["recording"]["configurations"] == 14
    for one, other in zip(*(result["stiffness"] for result in results), strict=True):
        assert abs(one["value"] - other["value"]) < 2.0 * other["std"], one["joint"]
        assert 0.9 < other["std"] / one["std"] < 1.3, one["joint"]


def test_one_attempt_of_each_configuration_counts(cell: Cell, measured: Readings, tmp_path: Path) -> None:
    rows = confirmed(measured)
    with Session.create(tmp_path / "s", PLAN_TEXT, cell) as session:
        first = session.begin_attempt(1, 0)
        session.record(first, rows[1, 0])
        session.end_attempt(first, completed=False, reason="load")
        second = session.begin_attempt(1, 0)
        session.record(second, rows[1, 0])
        session.record(second, rows[1, 1])
        session.end_attempt(second, completed=True)
        third = session.begin_attempt(2, 0)  # under way when the process was killed
        session.record(third, rows[2, 0])
        for visit in range(2):
            again = [
                ConfirmedReading(0, visit, one.point, one.time + visit, one.q, one.position, one.position_covariance, 5)
                for one in rows[3, 0]
            ]
            row = session.begin_attempt(0, 0)
            session.record(row, again)
            session.end_attempt(row, completed=True)
        found = observe(tmp_path / "s", cell)  # while another process writes to it
    places = set(zip(found.configuration.tolist(), found.step.tolist(), strict=True))
    assert places == {(1, 0), (1, 1), (2, 0), (0, 0), (0, 1)}
    assert len(found) == 3 * len(places)
    assert {note.kind for note in found.notes} == {"repeated", "interrupted"}
    assert not [path for path in (tmp_path / "s").iterdir() if path.suffix == ".tmp"]


def test_nothing_is_written_beside_a_session(whole: Path, cell: Cell, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "s")
    before = {path.name: path.read_bytes() for path in (tmp_path / "s").iterdir()}
    observe(tmp_path / "s", cell)
    assert {path.name: path.read_bytes() for path in (tmp_path / "s").iterdir()} == before


Change = Callable[[Path], None]


def sql(*statements: str) -> Change:
    def change(file: Path) -> None:
        with contextlib.closing(sqlite3.connect(file)) as database:
            for statement in statements:
                database.execute(statement)
            database.commit()

    return change


def content(**changes: object) -> Change:
    """Change what the first reading says."""

    def change(file: Path) -> None:
        with contextlib.closing(sqlite3.connect(file)) as database:
            (text,) = database.execute("SELECT content FROM reading WHERE id = 1").fetchone()
            new = json.dumps({**json.loads(text), **changes})
            database.execute("UPDATE reading SET content = ? WHERE id = 1", (new,))
            database.commit()

    return change


def cut(share: float) -> Change:
    def change(file: Path) -> None:
        data = file.read_bytes()
        file.write_bytes(data[: int(share * len(data))])

    return change


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
HOSTILE: dict[str, Change] = {
    "empty": lambda file: file.write_bytes(b"") and None,
    "another kind of file": lambda file: file.write_bytes(b"no database" * 100) and None,
    "a header and no more": lambda file: file.write_bytes(b"SQLite format 3\x00" + bytes(84)) and None,
    "half": cut(0.5),
    "almost whole": cut(0.9),
    "no readings": sql("DROP TABLE reading"),
    "another database": sql("DROP TABLE session"),
    "nothing confirmed": sql("DELETE FROM reading"),
    "two sessions in one": sql("INSERT INTO session SELECT * FROM session"),
    "another schema": sql("UPDATE session SET schema = 7"),
    "a plan without a hash": sql("UPDATE session SET plan_sha256 = 'ab'"),
    "a plan that is a number": sql("UPDATE session SET plan_sha256 = 5"),
    "points of another cell": sql("""UPDATE session SET points = '["p9"]'"""),
    "points that are no list": sql("UPDATE session SET points = '{'"),
    "a view without end": sql("DROP TABLE reading", f"CREATE VIEW reading AS {ENDLESS} SELECT i AS id FROM n"),
    "a table that computes without end": sql(
        "DROP TABLE attempt", f"CREATE VIEW attempt AS {ENDLESS} SELECT i AS id, 'completed' AS outcome FROM n"
    ),
    "a reading of no attempt": sql("DELETE FROM attempt WHERE id = 1"),
    "text for a configuration": sql("UPDATE reading SET configuration = 'one' WHERE id = 1"),
    "a configuration below zero": sql("UPDATE reading SET configuration = -1 WHERE id = 1"),
    "a step beyond all": sql("UPDATE reading SET step = 4294967296 WHERE id = 1"),
    "a time that is no number": sql("UPDATE reading SET time = 'now' WHERE id = 1"),
    "a point of another cell": sql("UPDATE reading SET point = 'mp9' WHERE id = 1"),
    "a point that is bytes": sql("UPDATE reading SET point = x'00ff' WHERE id = 1"),
    "content that is bytes": sql("UPDATE reading SET content = x'00' WHERE id = 1"),
    "content that is nothing": sql("UPDATE reading SET content = '' WHERE id = 1"),
    "content nested without end": sql("UPDATE reading SET content = replace(hex(zeroblob(200000)), '0', '[')"),
    "content larger than any": sql("UPDATE reading SET content = hex(zeroblob(2000000)) WHERE id = 1"),
    "content that is a list": sql("UPDATE reading SET content = '[]' WHERE id = 1"),
    "angles of another robot": content(q=[0.0] * 7),
    "angles that are not finite": sql("UPDATE reading SET content = replace(content, '\"q\": [', '\"q\": [NaN, ')"),
    "angles beyond all floats": content(q=[10**400] * 6),
    "angles in text": content(q=["0"] * 6),
    "a position of two": content(position=[1.0, 2.0]),
    "a covariance that is none": content(position_covariance=[[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "a variance below zero": content(position_covariance=[[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "a wrench of three": content(wrench=[1.0, 2.0, 3.0]),
    "no samples": content(samples=0),
    "a temperature in words": content(temperature="warm"),
    "conditions without words": sql("UPDATE condition SET content = '[{\"name\": 5}]'"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_database_gets_one_line(
    name: str, whole: Path, cell: Cell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(whole, tmp_path / "s")
    for log in tmp_path.glob("s/*-*"):
        log.unlink()
    HOSTILE[name](tmp_path / "s" / DATABASE)
    with pytest.raises(RecordingError) as caught:
        observe(tmp_path / "s", cell)
    assert DATABASE in str(caught.value)
    out = tmp_path / "out"
    assert main(["identify", str(tmp_path / "s" / DATABASE), "--cell", str(CELL), "--out", str(out)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert ": found " in lines[0]
    assert not out.exists()


def test_a_folder_in_place_of_the_database(cell: Cell, tmp_path: Path) -> None:
    (tmp_path / DATABASE).mkdir()
    with pytest.raises(RecordingError):
        observe(tmp_path, cell)
