"""Windows from markers and without."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.observations.plateaus import block_means, found_windows, marked_windows, standstills
from calibration_core.timeseries import NANOSECONDS, StepMarkers, TimeSeries


def markers(rows: list[tuple[int, int, int, int]]) -> StepMarkers:
    time, configuration, step, phase = np.array(rows).T
    return StepMarkers(time * NANOSECONDS, configuration, step, phase)


def test_measuring_phases(session: type) -> None:
    windows, notes = marked_windows(session().record().steps, 10**20)
    assert notes == []
    assert [(w.configuration, w.step) for w in windows] == [(c, s) for c in (1, 2, 3) for s in range(5)]
    assert all(w.end - w.begin == 2 * NANOSECONDS for w in windows)


def test_a_phase_without_end_ends_with_the_recording() -> None:
    windows, _ = marked_windows(markers([(0, 1, 0, 2), (5, 1, 0, 3)]), 9 * NANOSECONDS)
    assert [(w.begin, w.end) for w in windows] == [(5 * NANOSECONDS, 9 * NANOSECONDS + 1)]
    assert marked_windows(markers([(0, 1, 0, 2), (5, 1, 0, 3)]), 3 * NANOSECONDS)[0] == []


def test_a_repeated_configuration_counts_once() -> None:
    """Interrupted in step 1, measured again from step 0: the longer attempt is used."""
    rows = [(0, 1, 0, 3), (1, 1, 1, 3), (2, 1, 1, 5), (10, 1, 0, 3), (11, 1, 1, 3), (12, 1, 2, 3), (13, 1, 2, 5)]
    windows, notes = marked_windows(markers(rows), 10**12)
    assert [(w.step, w.begin // NANOSECONDS) for w in windows] == [(0, 10), (1, 11), (2, 12)]
    assert [(note.kind, note.place) for note in notes] == [("repeated", "configuration 1")]


def test_steps_are_found_without_markers(session: type, cell: Cell) -> None:
    for seed in range(5):
        played = session(seed=seed)
        found = found_windows(played.record(markers=False), cell)
        marked, _ = marked_windows(played.record().steps, 10**20)
        assert [(w.configuration, w.step) for w in found] == [(w.configuration, w.step) for w in marked]
        for ours, theirs in zip(found, marked, strict=True):
            hold = theirs.end - 4 * NANOSECONDS
            assert hold <= ours.begin < ours.end <= theirs.end + NANOSECONDS // 10
            assert ours.end - ours.begin > 1.5 * NANOSECONDS


def test_a_single_plateau_per_configuration_is_an_absolute_recording(session: type, cell: Cell) -> None:
    recording = session(loaded=False, configurations=6).record(markers=False)
    windows = found_windows(recording, cell)
    assert [(w.configuration, w.step) for w in windows] == [(c, 0) for c in range(1, 7)]


def test_an_unloaded_sensor_makes_no_steps(session: type, cell: Cell) -> None:
    recording = session(loaded=False, configurations=4).record(markers=False)
    time = np.arange(recording.joints.time[0], recording.joints.time[-1], 5_000_000)
    values = np.random.default_rng(0).normal(size=(len(time), 6))
    recording = dataclasses.replace(recording, wrench=TimeSeries(time, values, time))
    assert [(w.configuration, w.step) for w in found_windows(recording, cell)] == [(c, 0) for c in range(1, 5)]


def test_a_touched_load_is_no_new_step(session: type, cell: Cell) -> None:
    recording = session(loaded=False, configurations=1).record(markers=False)
    time = recording.joints.time[0] + np.arange(0, 20 * NANOSECONDS, 5_000_000)
    joints = TimeSeries(time[::4], np.zeros((len(time[::4]), 3)), time[::4])
    values = np.random.default_rng(0).normal(size=(len(time), 6))
    values[2000:2100, 0] += 50.0
    recording = dataclasses.replace(recording, wrench=TimeSeries(time, values, time), joints=joints)
    assert [(w.configuration, w.step) for w in found_windows(recording, cell)] == [(1, 0)]


def test_encoders_that_move_under_load_are_one_configuration(session: type) -> None:
    """0.8 mrad under 400 N is not a motion of 0.3 rad."""
    recording = session(elastic=2e-6).record()
    assert len(standstills(recording.joints)) == 3


def test_no_standstill() -> None:
    time = np.arange(1000) * 20_000_000
    moving = TimeSeries(time, np.sin(time / NANOSECONDS)[:, None] * [1.0, 0.5], time)
    assert standstills(moving) == []
    assert standstills(TimeSeries(time[:1], np.zeros((1, 2)), time[:1])) == []


def test_block_means() -> None:
    time = np.array([0, 1, 2, 10, 11, 30]) * 100_000_000
    means = block_means(TimeSeries(time, np.arange(6.0)[:, None], time), 0.3)
    assert means[1][:, 0].tolist() == [1.0, 3.5, 5.0]
    assert means[0].tolist() == [100_000_000, 1_050_000_000, 3_000_000_000]
