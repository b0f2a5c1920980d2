"""Time: stamps, receive times, order, repeats, gaps."""

from __future__ import annotations

import numpy as np

from calibration_core.recording.bags.streams import to_series
from calibration_core.recording.messages.kinds import Samples

MS = 1_000_000


def samples(stamp: list[int], values: list[float] | None = None, received: list[int] | None = None) -> Samples:
    n = len(stamp)
    rows = np.arange(n, dtype=float)[:, None] if values is None else np.array(values)[:, None]
    arrival = np.arange(n) * MS + 7 if received is None else np.array(received)
    return Samples(np.arange(n), np.array(stamp, np.int64), arrival, rows, frames={"f": n})


def kinds(notes: list) -> dict[str, int]:
    return {note.kind: note.count for note in notes}


def test_clean_stream_has_no_notes() -> None:
    series, efforts, notes = to_series(samples([MS * i for i in range(1, 50)]), "/t")
    assert notes == []
    assert efforts is None
    assert series.frame == "f"
    assert series.values[:, 0].tolist() == list(range(49))


def test_missing_stamp_takes_receive_time() -> None:
    series, _, notes = to_series(samples([5, 0, 9], received=[100, 7, 300]), "/t")
    assert series.time.tolist() == [5, 7, 9]
    assert kinds(notes) == {"missing_stamp": 1}


def test_out_of_order_is_sorted_and_counted() -> None:
    series, _, notes = to_series(samples([10, 30, 20, 40, 35]), "/t")
    assert series.time.tolist() == [10, 20, 30, 35, 40]
    assert series.values[:, 0].tolist() == [0, 2, 1, 4, 3]
    assert kinds(notes) == {"out_of_order": 2}


def test_repeated_messages_are_dropped_and_repeated_stamps_kept() -> None:
    series, _, notes = to_series(samples([10, 20, 20, 20, 30, 40], [1, 2, 2, 5, 6, 7]), "/t")
    assert series.time.tolist() == [10, 20, 20, 30, 40]
    assert series.values[:, 0].tolist() == [1, 2, 5, 6, 7]
    assert kinds(notes) == {"repeated_stamp": 2}


def test_a_clock_that_stands_still_is_not_used() -> None:
    series, _, notes = to_series(samples([10] * 8 + [20] * 2), "/t")
    assert series.time.tolist() == [i * MS + 7 for i in range(10)]
    assert kinds(notes) == {"clock_stands": 8}


def test_not_finite_is_left_out() -> None:
    series, _, notes = to_series(samples([1, 2, 3], [1.0, np.nan, np.inf]), "/t")
    assert series.time.tolist() == [1]
    assert kinds(notes) == {"non_finite": 2}


def test_gaps_are_counted() -> None:
    stamp = [MS * i for i in range(1, 100)] + [MS * (i + 300) for i in range(100, 200)]
    _, _, notes = to_series(samples(stamp), "/t")
    assert kinds(notes) == {"gap": 1}
    assert "0.301 s" in notes[0].text


def test_efforts_follow_their_positions() -> None:
    made = samples([30, 10, 20])
    efforts = np.array([[3.0], [1.0], [np.nan]])
    series, torque, _ = to_series(
        Samples(made.order, made.stamp, made.received, made.values, efforts, made.frames), "/t"
    )
    assert series.time.tolist() == [10, 20, 30]
    assert torque is not None
    assert torque.time.tolist() == [10, 30]
    assert torque.values[:, 0].tolist() == [1.0, 3.0]


def test_nothing_is_an_empty_series() -> None:
    series, _, notes = to_series(Samples(*[np.empty(0, np.int64)] * 3, np.empty((0, 3))), "/t")
    assert len(series) == 0
    assert notes == []
