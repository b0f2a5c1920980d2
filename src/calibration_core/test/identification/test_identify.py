"""The one entry: what kind of recording it is, and which options mean nothing to it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from robots import loaded_readings, write_cell

from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.observations.kinds import is_loaded


def test_steps_and_a_wrench_make_a_loaded_recording(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 1)
    assert is_loaded(readings)
    assert not is_loaded(readings.select(readings.step == 0))
    assert not is_loaded(dataclasses.replace(readings, wrench=None))
    assert identify(readings, cell).kind == "loaded"


def test_options_without_effect_are_named(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 2)
    unloaded = readings.select(readings.step == 0)
    found = identify(unloaded, cell, Options(weights="plain", deflections="pose"))
    assert found.kind == "absolute"
    assert [note.place for note in found.notes if note.kind == "option"] == ["weights", "deflections"]
    assert not [note for note in identify(unloaded, cell).notes if note.kind == "option"]
