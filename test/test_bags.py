"""The bags that come with the project are read, with and without their markers, to the same readings."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration_core.cell import load_cell
from calibration_core.observations.observe import observe_recording
from calibration_core.recording.bags.bag import read_bag

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
