"""The bags that come with the project are read, with and without their markers, to the same readings."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.measurement.session import Session
from calibration_core.observations.average import Average
from calibration_core.observations.observe import observe, observe_recording
from calibration_core.observations.plateaus import marked_windows
from calibration_core.observations.window import Averaging, SettledWindow
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.bags.writer import write_bag
from calibration_core.recording.session_values import ConfirmedReading
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import Streams, TimeSeries
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.streams import simulate_recording
from calibration_sim.cell.truth import draw_truth

ROOT = Path(__file__).resolve().parents[1]


def test_small_loaded() -> None:
    cell = load_cell(ROOT / "config" / "cells" / "small.cell.yaml")
    recording = read_bag(ROOT / "bags" / "small_loaded", cell)
    marked = observe_recording(recording, cell)
    found = observe_recording(dataclasses.replace(recording, steps=None), cell)
    assert len(marked) == len(found) == 3 * 4 * 3
    rows = [np.lexsort((one.point, one.step, one.configuration)) for one in (marked, found)]
    for name in ("configuration", "step", "point"):
        assert np.array_equal(getattr(marked, name)[rows[0]], getattr(found, name)[rows[1]])
    change = np.abs(marked.position[rows[0]] - found.position[rows[1]])
    assert change.max() < 5e-5


def test_every_bag_is_listed() -> None:
    listed = (ROOT / "bags" / "README.md").read_text()
    bags = [path.name for path in (ROOT / "bags").iterdir() if path.is_dir()]
    assert bags
    assert all(f"`{name}/`" in listed for name in bags)


def _confirmed(series: TimeSeries, begin: int, end: int) -> Average:
    """Average the first settled window of a stream, as a cell does while it measures."""
    averaging = Averaging(begin, 1.9, np.full(series.values.shape[1], np.inf), 10)
    for time, values in zip(series.time, series.values, strict=True):
        if begin <= time < end:
            averaging.add(int(time), values)
            state = averaging.state()
            if isinstance(state, SettledWindow):
                return state.average
    raise AssertionError(averaging.state())


def _session(folder: Path, streams: Streams, cell: Cell) -> None:
    """Confirm the readings of streams one by one."""
    assert streams.steps is not None
    assert streams.wrench is not None
    windows, _ = marked_windows(streams.steps, int(streams.joints.time[-1]))
    with Session.create(folder, "schema: 1\n", cell) as session:
        for number in sorted({window.configuration for window in windows}):
            attempt = session.begin_attempt(number, 0)
            for window in (one for one in windows if one.configuration == number):
                stretch = window.begin, window.end
                force, joints = _confirmed(streams.wrench, *stretch), _confirmed(streams.joints, *stretch)
                points = {name: _confirmed(series, *stretch) for name, series in streams.points.items()}
                session.record(attempt, [
                    ConfirmedReading(
                        number, window.step, name, window.begin, joints.mean, one.mean, one.covariance, one.samples,
                        force.mean, force.covariance,
                    )
                    for name, one in points.items()
                ])  # fmt: skip
            session.end_attempt(attempt, completed=True)


def test_a_session_answers_as_its_own_bag_and_as_a_table(tmp_path: Path) -> None:
    path = ROOT / "config" / "cells" / "demo.cell.yaml"
    cell = load_cell(path)
    streams = simulate_recording(cell, draw_truth(cell, 4), random_protocol(cell, 14, 4, levels=(0.0, 0.5, 1.0)), 4)
    write_bag(tmp_path / "bag", streams, cell)
    write_table(tmp_path / "table.csv", observe(tmp_path / "bag", cell))
    _session(tmp_path / "session", streams, cell)

    def answered(recording: str) -> dict[str, Any]:
        out = tmp_path / f"out of {recording}"
        assert main(["diagnose", str(tmp_path / recording), "--cell", str(path), "--no-report", "--out", str(out)]) == 0
        result: dict[str, Any] = json.loads((out / "result.json").read_text(encoding="utf-8"))
        return result

    bag = answered("bag")
    for other in map(answered, ("session", "table.csv")):
        assert other["verdict"] == bag["verdict"] == "consistent"
        assert other["anomalies"] == bag["anomalies"] == []
        assert abs(other["fit"]["noise"] / bag["fit"]["noise"] - 1) < 0.03
        for one, same in zip(other["stiffness"], bag["stiffness"], strict=True):
            assert abs(one["value"] - same["value"]) < 0.2 * same["std"]
            assert abs(one["std"] / same["std"] - 1) < 0.05
