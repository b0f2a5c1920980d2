"""Values are checked, copied and frozen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.timeseries import Note, Provenance, Readings, StepMarkers, Streams, TimeSeries, read_only


def series(n: int = 3) -> TimeSeries:
    return TimeSeries(np.arange(n), np.zeros((n, 2)), np.arange(n))


def readings(n: int = 4, **changes: object) -> Readings:
    values = {
        "points": ("a",), "configuration": np.arange(n), "step": np.zeros(n, np.int64), "point": np.zeros(n, np.int64),
        "q": np.zeros((n, 3)), "position": np.arange(3.0 * n).reshape(n, 3), "wrench": None,
        "time": np.full(n, np.nan), "temperature": np.full(n, np.nan), "provenance": Provenance("", "csv", {}, {}),
    }  # fmt: skip
    return Readings(**{**values, **changes})


def test_arrays_are_copies_that_cannot_be_written() -> None:
    values = np.zeros((3, 2))
    one = TimeSeries(np.arange(3), values, np.arange(3))
    values[0, 0] = 5.0
    assert one.values[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        one.values[0, 0] = 1.0
    assert one.time.dtype == np.int64
    assert len(one) == 3


@pytest.mark.parametrize(
    ("time", "values", "received"),
    [
        (np.arange(3), np.zeros((2, 2)), np.arange(3)),
        (np.arange(3), np.zeros((3, 2)), np.arange(2)),
        (np.arange(3), np.zeros(3), np.arange(3)),
        (np.array([0, 2, 1]), np.zeros((3, 2)), np.arange(3)),
    ],
)
def test_series_that_are_none(time: np.ndarray, values: np.ndarray, received: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"expected|decreases"):
        TimeSeries(time, values, received)


def test_markers_of_unequal_length() -> None:
    with pytest.raises(ValueError, match="unequal"):
        StepMarkers(np.arange(3), np.arange(3), np.arange(3), np.arange(2))


def test_points_of_a_recording_are_frozen() -> None:
    one = Streams(series(), {"a": series()}, None, None, None, "", Provenance("", "", {}, {}))
    with pytest.raises(TypeError):
        one.points["b"] = series()  # type: ignore[index]
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.wrench = series()  # type: ignore[misc]


def test_readings_of_unequal_length() -> None:
    with pytest.raises(ValueError, match="q has 3 rows, configuration has 4"):
        readings(q=np.zeros((3, 3)))


def test_select_keeps_what_belongs_together() -> None:
    whole = readings(samples=np.array([5, 6, 7, 8]), position_covariance=np.zeros((4, 3, 3)))
    mask = np.array([True, False, True, False])
    for rows in (mask, np.array([0, 2])):
        part = whole.select(rows)
        assert part.configuration.tolist() == [0, 2]
        assert part.samples is not None
        assert part.samples.tolist() == [5, 7]
        assert part.position.tolist() == [[0, 1, 2], [6, 7, 8]]
        assert part.wrench is None
        assert part.points == ("a",)


def test_notes_are_added() -> None:
    note = Note("gap", "/t", "a gap")
    assert readings().with_notes(note).with_notes(note).notes == (note, note)


def test_read_only() -> None:
    assert not read_only([1, 2]).flags.writeable
    assert read_only([1, 2], np.int64).dtype == np.int64
