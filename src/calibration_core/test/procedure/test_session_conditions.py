"""Conditions and overrides in a session; sessions that were begun before there were any."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from calibration_core.cell import Cell
from calibration_core.measurement.session import DATABASE, Session
from calibration_core.timeseries import Condition, Override

WHO = Override("temperature", "A. Smith", "no cooling today")
HOT = Condition(
    "temperature", "5.1", "test temperature", "20 °C ± 2 °C", "25.0 °C", met=False, shall=True, override=WHO
)
SERVO = Condition("servo", "5.1", "servos activated", "on", "unknown", met=None, shall=True)


def test_what_was_seen_and_who_overrode_it_is_kept(tmp_path: Path, demo_cell: Cell) -> None:
    with Session.create(tmp_path / "s", "plan", demo_cell) as session:
        assert session.conditions == session.overrides == ()
        session.override(1, WHO)
        session.judge(2, (HOT, SERVO))
        session.judge(3, (SERVO,))
    with Session.look(tmp_path / "s") as session:
        assert session.overrides == (WHO,)
        assert session.conditions == ((HOT, SERVO), (SERVO,))


def test_a_session_of_an_earlier_version_goes_on(tmp_path: Path, demo_cell: Cell) -> None:
    Session.create(tmp_path / "s", "plan", demo_cell).close()
    database = sqlite3.connect(tmp_path / "s" / DATABASE)
    database.executescript("DROP TABLE condition; DROP TABLE override;")
    database.close()
    with Session.look(tmp_path / "s") as session:
        assert session.conditions == session.overrides == ()
    with Session.resume(tmp_path / "s", "plan", demo_cell) as session:
        session.override(1, WHO)
        assert session.overrides == (WHO,)


def test_what_was_given_up_so_often_is_not_tried_again(tmp_path: Path, demo_cell: Cell) -> None:
    with Session.create(tmp_path / "s", "plan", demo_cell) as session:
        for number, completed in ((1, False), (1, False), (2, False), (2, True), (3, False)):
            session.end_attempt(session.begin_attempt(number, 1), completed=completed, reason="blocked")
        assert session.given_up(2) == {1}
        assert session.given_up(1) == {1, 3}


@pytest.mark.parametrize("met", [True, None])
def test_only_a_violation_stops(met: bool | None) -> None:
    assert not Condition("servo", "5.1", "servos activated", "on", "?", met=met, shall=True).stops
