"""From streams to rows."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import ObservationError
from calibration_core.observations.observe import observe, observe_recording
from calibration_core.recording.bags.writer import write_bag
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import NANOSECONDS, Readings, Streams, TimeSeries

COMPLIANCE = np.array([2.0e-6, -1.0e-6, 1.5e-6])
LOADS = np.array([0.0, 150.0, 400.0, 150.0, 0.0])


def truth(session: object, readings: Readings) -> tuple[np.ndarray, np.ndarray]:
    load = LOADS[readings.step]
    place = [session.place(c - 1, p) for c, p in zip(readings.configuration, readings.point, strict=True)]
    return np.array(place) + load[:, None] * COMPLIANCE, load


@pytest.mark.parametrize("markers", [True, False])
def test_rows_are_what_was_played(session: type, cell: Cell, markers: bool) -> None:
    played = session()
    readings = observe_recording(played.record(markers=markers), cell)
    assert len(readings) == 3 * 5 * 2
    place, load = truth(played, readings)
    assert readings.position == pytest.approx(place, abs=1e-5)
    assert readings.wrench[:, :3] == pytest.approx(load[:, None] * [0.6, 0.0, -0.8], abs=0.6)
    angles = np.array([played.angles(c - 1) for c in readings.configuration]) + 2e-6 * load[:, None]
    assert readings.q == pytest.approx(angles, abs=2e-6)
    assert readings.temperature == pytest.approx(20.5)
    assert np.all(np.diff(readings.time) >= 0)
    error = (readings.position - place) / np.sqrt(np.einsum("mii->mi", readings.position_covariance))
    assert 0.8 < np.sqrt(np.mean(error**2)) < 1.25
    assert {note.kind for note in readings.notes} <= {"clock_offset", "no_markers"}


@pytest.mark.parametrize("markers", [True, False])
def test_absolute_recordings(session: type, cell: Cell, markers: bool) -> None:
    readings = observe_recording(session(loaded=False, configurations=7).record(markers=markers), cell)
    assert readings.wrench is None
    assert readings.wrench_covariance is None
    assert sorted(set(readings.configuration.tolist())) == list(range(1, 8))
    assert not readings.step.any()


def test_live_equals_replay(session: type, cell: Cell, tmp_path: Path) -> None:
    """The same arrays from memory, from a bag and through a table: the same rows, to the bit."""
    recording = session(tracker_ahead=0.05).record()
    live = observe_recording(recording, cell)
    for storage in ("mcap", "sqlite3"):
        write_bag(tmp_path / storage, recording, cell, storage=storage)
        replay = observe(tmp_path / storage, cell)
        for field in dataclasses.fields(Readings):
            if isinstance(getattr(live, field.name), np.ndarray):
                assert getattr(live, field.name).tobytes() == getattr(replay, field.name).tobytes(), field.name
        assert [note for note in replay.notes if note.kind != "gap"] == list(live.notes)
    write_table(tmp_path / "t.csv", live)
    table = observe(tmp_path / "t.csv", cell)
    assert np.array_equal(table.position, live.position)
    assert np.array_equal(table.wrench, live.wrench)


def disturbed(recording: Streams, begin: float, end: float, change: np.ndarray) -> Streams:
    """Add a movement to the left point between two times, s."""
    series = recording.points["left"]
    seconds = (series.time - series.time[0]) / NANOSECONDS
    inside = (seconds >= begin) & (seconds < end)
    values = series.values.copy()
    values[inside] += (seconds[inside] - begin)[:, None] / (end - begin) * change
    points = {**recording.points, "left": dataclasses.replace(series, values=values)}
    return dataclasses.replace(recording, points=points)


def test_a_reading_that_never_settles_is_set_aside(session: type, cell: Cell) -> None:
    recording = disturbed(session().record(), 7.4, 9.5, np.array([0.0, 1e-3, 0.0]))  # step 1 of configuration 1
    readings = observe_recording(recording, cell)
    notes = [note for note in readings.notes if note.kind == "unsettled"]
    assert [note.place for note in notes] == ["configuration 1, step 1, left"]
    assert "µm" in notes[0].text
    assert len(readings) == 29


def test_points_measured_one_after_another_have_their_own_values(session: type, cell: Cell) -> None:
    """The tracker sees one point in the first half of each window and the other in the second."""
    recording = session(noise=0.0).record()
    seconds = (recording.wrench.time - recording.wrench.time[0]) / NANOSECONDS
    drift = recording.wrench.values + seconds[:, None] * [0.5, 0, 0, 0, 0, 0]
    points = {}
    for i, (name, series) in enumerate(recording.points.items()):
        at = ((series.time - recording.joints.time[0]) / NANOSECONDS - 2.0) % 5.5  # the first configuration
        seen = (at < 1.0) if i == 0 else (at >= 1.0)
        points[name] = TimeSeries(series.time[seen], series.values[seen], series.received[seen])
    recording = dataclasses.replace(
        recording, points=points, wrench=dataclasses.replace(recording.wrench, values=drift)
    )
    readings = observe_recording(recording, cell)
    first = readings.select(readings.configuration == 1)
    forces = first.wrench[:, 0] - LOADS[first.step] * 0.6
    assert forces == pytest.approx(0.5 * (first.time), abs=0.01)
    assert len(set(first.time.tolist())) == len(first)


def test_single_readings_of_the_instrument(session: type, cell: Cell) -> None:
    """A tracker that averages by itself sends one position per window; the window gives q and wrench."""
    recording = session().record()
    windows = recording.steps.time[recording.steps.phase == 3] + NANOSECONDS
    points = {
        name: TimeSeries(windows, [series.values[np.searchsorted(series.time, t)] for t in windows], windows)
        for name, series in recording.points.items()
    }
    readings = observe_recording(dataclasses.replace(recording, points=points), cell)
    assert len(readings) == 30
    assert np.all(readings.samples == 1)
    assert not readings.position_covariance.any()
    assert readings.wrench_covariance.any()


def test_sparse_joint_states_are_interpolated(session: type, cell: Cell) -> None:
    recording = session().record()
    few = slice(None, None, 75)
    joints = recording.joints
    joints = TimeSeries(joints.time[few], joints.values[few], joints.received[few])
    readings = observe_recording(dataclasses.replace(recording, joints=joints), cell)
    assert len(readings) == 30
    assert readings.q == pytest.approx(observe_recording(recording, cell).q, abs=1e-3)


def test_missing_wrench_is_named(session: type, cell: Cell) -> None:
    recording = session().record()
    wrench = recording.wrench
    keep = np.abs((wrench.time - wrench.time[0]) / NANOSECONDS - 8.5) > 1.5
    wrench = TimeSeries(wrench.time[keep], wrench.values[keep], wrench.received[keep])
    readings = observe_recording(dataclasses.replace(recording, wrench=wrench), cell)
    places = [note.place for note in readings.notes if note.kind == "missing"]
    assert places == ["configuration 1, step 1, left", "configuration 1, step 1, right"]


def test_wild_samples_are_counted(session: type, cell: Cell) -> None:
    recording = session().record()
    series = recording.points["left"]
    values = series.values.copy()
    values[300] += 0.01
    points = {**recording.points, "left": dataclasses.replace(series, values=values)}
    readings = observe_recording(dataclasses.replace(recording, points=points), cell)
    assert [note.count for note in readings.notes if note.kind == "outlier_samples"] == [1]


def test_nothing_to_see(session: type, cell: Cell) -> None:
    recording = session().record(markers=False)
    time = recording.joints.time
    moving = TimeSeries(time, np.cumsum(np.full((len(time), 3), 0.01), axis=0), time)
    with pytest.raises(ObservationError, match="found no plateau"):
        observe_recording(dataclasses.replace(recording, joints=moving), cell)
