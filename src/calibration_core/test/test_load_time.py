"""The time that a load may take: both clocks, signs of life, instruments that are lost."""

from __future__ import annotations

from calibration_core.measurement.load_time import LOAD_TIME, LoadTime

TICK = 0.02  # s between two looks


def looks(seconds: float, heard: float, ended: float, *, age: float = 1.0, rate: float = 1.0) -> list[float]:
    """Look every tick; return the moments at which the load would be judged, s after it came.

    Args:
        seconds: To look for.
        heard: s between two signs of life.
        ended: s at which they end.
        age: s of silence after which the instrument is lost.
        rate: Of the cell's clock.
    """
    load, last, judged = LoadTime(0.0, 0.0), 0.0, []
    for tick in range(1, round(seconds / TICK) + 1):
        now = tick * TICK
        if now < ended:
            last = now - now % heard
        load = load.looked(rate * now, now, lost=now - last > age)
        if load.over(lambda since, last=last: last > since):
            judged.append(now)
    return judged


def test_a_load_is_judged_although_signs_of_life_come_less_often_than_looks() -> None:
    judged = looks(6.0, 0.25, 60.0)
    assert LOAD_TIME < judged[0] <= LOAD_TIME + 0.25 + 2 * TICK


def test_both_clocks_have_to_advance() -> None:
    assert looks(5.9, 0.25, 60.0, rate=0.5) == []
    assert looks(6.6, 0.25, 60.0, rate=0.5)
    assert looks(6.0, 0.25, 60.0, rate=20.0)[0] > LOAD_TIME


def test_a_sensor_that_ends_within_the_time_is_never_judged() -> None:
    for ended in (0.5, 1.9, 2.5, 2.99):
        assert looks(20.0, 0.25, ended) == [], ended


def test_the_time_begins_anew_when_an_instrument_is_back() -> None:
    load = LoadTime(0.0, 0.0).looked(2.0, 2.0, lost=True)
    assert (load.cell, load.steady, load.due) == (2.0, 2.0, None)
    assert load.looked(4.9, 4.9, lost=False).due is None
    again = load.looked(5.1, 5.1, lost=False)
    assert again.due == 5.1
    assert not again.over(lambda since: since < 5.1)
    assert again.over(lambda since: since < 5.2)
