"""A small cell and recordings of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.timeseries import Provenance, StepMarkers, Streams, TimeSeries

START = 1_700_000_000_000_000_000
CELL = """
name: small
robot:
  name: three joints
  dh: [{a: 0.1, alpha: 1.5, d: 0.4}, {a: 0.5, alpha: 0, d: 0}, {a: 0.4, alpha: 0, d: 0}]
  joints: [shoulder, elbow, wrist]
  joint_limits: [[-3, 3], [-3, 3], [-3, 3]]
  rated_load: 50
frames:
  measurement_points: {left: [0.1, 0, 0], right: [0, 0.1, 0]}
instruments:
  tracker: {sigma: 2.0e-5}
  force_torque: {sigma_force: 1.0, sigma_torque: 0.5}
"""


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    path = tmp_path / "cell.yaml"
    path.write_text(CELL)
    return load_cell(path)


def make_recording(seed: int = 0, n: int = 200, *, efforts: bool = True) -> Streams:
    """Return streams of random numbers at different rates, with step markers and a robot description."""
    rng = np.random.default_rng(seed)

    def series(count: int, columns: int, frame: str) -> TimeSeries:
        time = START + np.sort(rng.choice(10**9, count, replace=False))
        return TimeSeries(time, rng.normal(size=(count, columns)), time + 1000, frame)

    joints = series(n, 3, "")
    return Streams(
        joints=joints,
        points={"left": series(n // 2, 3, "tracker"), "right": series(n // 3, 3, "tracker")},
        wrench=series(3 * n, 6, "force_torque"),
        temperature=series(5, 1, "air"),
        steps=StepMarkers(START + np.arange(4) * 10**8, [1, 1, 1, 1], [0, 0, 1, 1], [0, 3, 1, 5]),
        robot_description="<robot name='three joints'/>",
        provenance=Provenance("made", "mcap", {}, {}),
        joint_efforts=TimeSeries(joints.time, rng.normal(size=(n, 3)), joints.received) if efforts else None,
    )


@pytest.fixture
def recording() -> Streams:
    return make_recording()


def series_equal(a: TimeSeries | None, b: TimeSeries | None) -> bool:
    if a is None or b is None:
        return a is b
    return (
        np.array_equal(a.time, b.time)
        and a.values.tobytes() == b.values.tobytes()
        and np.array_equal(a.received, b.received)
    )


@pytest.fixture
def same() -> Callable[[Streams, Streams], None]:
    """Return a function that asserts that two recordings hold the same data, to the bit."""

    def check(a: Streams, b: Streams) -> None:
        assert series_equal(a.joints, b.joints)
        assert series_equal(a.wrench, b.wrench)
        assert series_equal(a.temperature, b.temperature)
        assert a.points.keys() == b.points.keys()
        assert all(series_equal(a.points[name], b.points[name]) for name in a.points)
        assert series_equal(a.joint_efforts, b.joint_efforts)
        assert a.robot_description == b.robot_description
        assert a.steps is not None
        assert b.steps is not None
        for name in ("time", "configuration", "step", "phase"):
            assert np.array_equal(getattr(a.steps, name), getattr(b.steps, name))

    return check
