"""A tracker whose clock is seconds off and gains: readings as good as by the robot's clock, live and replayed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from calibration_core.cell import load_cell
from calibration_core.measurement.session import Session
from calibration_core.observations.average import average
from calibration_core.recording.bags.bag import read_bag
from calibration_core.timeseries import NANOSECONDS
from calibration_sim.cell.streams import START

CELL = Path(__file__).resolve().parents[2] / "config" / "cells" / "demo.cell.yaml"
SPEED = 8.0  # times real time
PERIOD = 0.2  # s between two samples of the tracker: config/simulation.yaml
OFF, LATER = 0.05, 0.003  # s, that corrected stamps may be off, and those of the second half
RATE = 5e-5  # that the rate may be off
DEVIATIONS = 6.0  # between two readings of one place
OWN = {"tracker_clock_offset": 5.6, "tracker_clock_rate": 1.001}


def test_readings_of_a_tracker_with_a_clock_of_its_own(suite: Any, short_plan: Path, tmp_path: Path) -> None:
    from calibration_interfaces.msg import Outcome, SampleCheck

    checks: list[Any] = []
    suite.client.create_subscription(SampleCheck, "calibration/sample_check", checks.append, 1000)
    readings = []
    for name, clock, stamp in (("robots", {}, "sender"), ("own", OWN, "sender_offset")):
        suite.directory = tmp_path / name
        suite.directory.mkdir()
        suite.start_fast(speed=SPEED, simulated_cell=clock, tracker={"stamp": stamp})
        result = suite.run(short_plan).result(400.0)
        assert result.outcome.code == Outcome.OK, (result.outcome.text, suite.log("sequencer")[-3000:])
        suite.stop()
        with Session.look(suite.session) as session:
            readings.append({(one.configuration, one.step, one.point): one for one in session.confirmed()})
            clocks = [one.text for one in session.events if one.kind == "tracker_clock"]
    text = [one.text for one in checks if one.name == "mp1"][-1]
    assert abs(float(text.partition(", rate ")[2].split()[0]) - OWN["tracker_clock_rate"]) < RATE, text
    assert clocks, "the session knows of the clock"
    plain, corrected = readings
    assert set(plain) == set(corrected)
    off = []
    for place, one in plain.items():
        other, std = corrected[place], np.sqrt(np.diag(one.position_covariance + corrected[place].position_covariance))
        off.append(float(np.max(np.abs(one.position - other.position) / std)))
    print(f"{len(off)} readings, at most {max(off):.1f} standard deviations from those by the robot's clock")
    assert max(off) < DEVIATIONS

    bag = read_bag(suite.bag, load_cell(CELL))
    (note,) = [one for one in bag.notes if one.kind == "tracker_clock"]
    assert note.text.endswith("; its stamps are corrected")
    assert not [one for one in bag.notes if one.kind in ("out_of_order", "repeated_stamp")]
    late = [(series.time - START) / NANOSECONDS for series in bag.points.values()]  # taken at whole periods
    late = [seconds - PERIOD * np.round(seconds / PERIOD) for seconds in late]
    print(f"{note.text}; corrected stamps are off by {1e3 * max(np.abs(one).max() for one in late):.2f} ms at most")
    for one in late:
        assert np.abs(one).max() < OFF
        assert np.abs(one[len(one) // 2 :]).max() < LATER
    for (_, _, point), one in corrected.items():
        series = bag.points[point]
        first = [
            row
            for row in range(len(series) - one.samples + 1)
            if np.array_equal(average(series.values[row : row + one.samples]).mean, one.position)
        ]
        assert len(first) == 1, "a reading is the mean of samples in the bag, to the bit"
