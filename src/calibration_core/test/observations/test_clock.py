"""The clock offset is estimated within its uncertainty, and taken out on the clock that is wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.observations.clock import ClockOffset, clock_offset, corrected, on_one_base
from calibration_core.observations.plateaus import marked_windows
from calibration_core.timeseries import NANOSECONDS, Streams


def estimate(recording: Streams, cell: Cell) -> ClockOffset:
    windows, _ = marked_windows(recording.steps, 10**20)
    found = clock_offset(recording, windows, cell)
    assert found is not None
    return found


@pytest.mark.parametrize("ahead", [-0.4, -0.05, 0.0, 0.03, 0.25])
@pytest.mark.parametrize("rate", [10.0, 100.0])
def test_estimate(session: type, cell: Cell, ahead: float, rate: float) -> None:
    found = estimate(session(tracker_ahead=ahead, configurations=6, rate=rate).record(), cell)
    assert found.ramps == 24
    assert abs(found.seconds - ahead) < 4.0 * found.std + 1e-4
    assert found.std < 0.01
    assert found.significant == (ahead != 0.0)


def test_the_standard_deviation_is_honest(session: type, cell: Cell) -> None:
    pulls = [
        (found.seconds - 0.02) / found.std
        for seed in range(25)
        if (found := estimate(session(tracker_ahead=0.02, seed=seed).record(), cell))
    ]
    assert 0.6 < np.std(pulls) < 1.5
    assert abs(np.mean(pulls)) < 0.8


def test_correction_of_the_tracker(session: type, cell: Cell) -> None:
    recording = session(tracker_ahead=0.1).record()
    better, notes = corrected(recording, estimate(recording, cell))
    assert notes[0].kind == "clock_offset"
    assert "100." in notes[0].text or "99." in notes[0].text
    assert "corrected" in notes[0].text
    assert abs(estimate(better, cell).seconds) < 0.002
    assert np.array_equal(better.wrench.time, recording.wrench.time)


def test_correction_of_the_sensor(session: type, cell: Cell) -> None:
    recording = session().record()
    late = dataclasses.replace(recording.wrench, time=recording.wrench.time + NANOSECONDS // 10)
    recording = dataclasses.replace(recording, wrench=late)
    better, notes = corrected(recording, estimate(recording, cell))
    assert notes[0].place == "force/torque sensor"
    assert np.array_equal(better.points["left"].time, recording.points["left"].time)
    assert abs(float(np.mean(better.wrench.time - session().record().wrench.time))) < 2e6


def test_insignificant_is_reported_only(session: type, cell: Cell) -> None:
    recording = session().record()
    same, notes = corrected(recording, estimate(recording, cell))
    assert same is recording
    assert "not significant" in notes[0].text


def test_without_ramps_there_is_no_estimate(session: type, cell: Cell) -> None:
    recording = session(loaded=False).record()
    windows, _ = marked_windows(recording.steps, 10**20)
    assert clock_offset(recording, windows, cell) is None
    assert corrected(recording, None) == (recording, [])


def test_streams_on_another_time_base_are_shifted(session: type) -> None:
    """A sensor that counts from its own start-up."""
    recording = session().record()
    boot = dataclasses.replace(recording.wrench, time=recording.wrench.time - 1_600_000_000 * NANOSECONDS)
    shifted = on_one_base(dataclasses.replace(recording, wrench=boot))
    assert np.array_equal(shifted.wrench.time, recording.wrench.time)
    assert [note.kind for note in shifted.notes] == ["time_base"]
    assert on_one_base(recording) is recording


def test_streams_that_waited_in_a_queue_are_on_one_base(session: type) -> None:
    """A recorder that cannot keep up receives late, most of the time even; what it received soonest tells the base."""
    recording = session().record()
    joints = recording.joints
    late = joints.received + (np.linspace(0.0, 100.0, len(joints)) * NANOSECONDS).astype(np.int64)
    late[: len(joints) // 20] = joints.received[: len(joints) // 20]
    waited = dataclasses.replace(recording, joints=dataclasses.replace(joints, received=late))
    assert on_one_base(waited) is waited
