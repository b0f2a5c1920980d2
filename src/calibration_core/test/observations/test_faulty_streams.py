"""Zeros of a lost target, two publishers on a topic and readings that stand still are named, and change no result."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import RecordingError
from calibration_core.observations.clock import refuse_frozen
from calibration_core.observations.observe import observe_recording
from calibration_core.recording.bags.bag import read_bag
from calibration_core.timeseries import Readings, Streams, TimeSeries

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell(ROOT / "config" / "cells" / "small.cell.yaml")


@pytest.fixture(scope="module")
def good(cell: Cell) -> Streams:
    return read_bag(ROOT / "bags" / "small_loaded", cell)


def with_values(series: TimeSeries, values: np.ndarray) -> TimeSeries:
    return TimeSeries(series.time, values, series.received, series.frame)


def doubled(series: TimeSeries, values: np.ndarray) -> TimeSeries:
    """Return a series with the messages of a second publisher, 1 ms after each."""
    rows = np.argsort(np.concatenate([series.time, series.time + 1_000_000]), kind="stable")
    time = np.concatenate([series.time, series.time + 1_000_000])[rows]
    return TimeSeries(time, np.concatenate([series.values, values])[rows], time, series.frame)


def test_zeros_of_a_lost_target_are_left_out(cell: Cell, good: Streams) -> None:
    series = good.points["mp1"]
    values = series.values.copy()
    values[100:160] = 0.0
    read = observe_recording(
        dataclasses.replace(good, points={**good.points, "mp1": with_values(series, values)}), cell
    )
    assert [note.count for note in read.notes if note.kind == "zeros"] == [60]
    assert np.abs(read.position).max(axis=1).min() > 0.1
    nothing = {**good.points, "mp1": with_values(series, 0.0 * values)}
    with pytest.raises(RecordingError, match="/tracker/mp1: found zeros in all messages"):
        observe_recording(dataclasses.replace(good, points=nothing), cell)


def second(good: Streams) -> dict[str, Streams]:
    joints, point, wrench = good.joints, good.points["mp1"], good.wrench
    assert wrench is not None
    points = {**good.points, "mp1": doubled(point, point.values + 0.001)}
    return {
        "/joint_states": dataclasses.replace(good, joints=doubled(joints, joints.values + 0.002)),
        "/tracker/mp1": dataclasses.replace(good, points=points),
        "/force_torque/wrench": dataclasses.replace(good, wrench=doubled(wrench, 0.0 * wrench.values)),
    }


@pytest.mark.parametrize("topic", ["/joint_states", "/tracker/mp1", "/force_torque/wrench"])
def test_a_second_publisher_is_named(cell: Cell, good: Streams, topic: str) -> None:
    with pytest.raises(RecordingError, match=f"{topic}: found .* two publishers write on it"):
        observe_recording(second(good)[topic], cell)


def test_a_second_publisher_of_the_same_numbers_does_not_matter(cell: Cell, good: Streams) -> None:
    read = observe_recording(dataclasses.replace(good, joints=doubled(good.joints, good.joints.values)), cell)
    assert len(read) == len(observe_recording(good, cell))


def still(attribute: str) -> Callable[[Readings], Readings]:
    """Return what gives all readings after the first configuration the same numbers."""

    def change(readings: Readings) -> Readings:
        values = getattr(readings, attribute).copy()
        for point in np.unique(readings.point):
            later = (readings.configuration > 1) & ((readings.point == point) | (attribute == "wrench"))
            values[later] = values[np.flatnonzero(later)[0]]
        return dataclasses.replace(readings, **{attribute: values})

    return change


@pytest.mark.parametrize(("attribute", "name"), [("position", "mp1"), ("q", "joint angles"), ("wrench", "wrench")])
def test_what_stands_still_is_named(cell: Cell, good: Streams, attribute: str, name: str) -> None:
    readings = observe_recording(good, cell)
    refuse_frozen(readings, cell)
    with pytest.raises(RecordingError, match=f"{name}: found .* to the last digit, in .* 3"):
        refuse_frozen(still(attribute)(readings), cell)
