"""Trackers and targets that stand elsewhere than stated, and what is none: own weight, geometry, no freedom."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from loaded_cases import true_state
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.findings.loaded import TARGETS, TRACKER, registration
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded, refitted_frames
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.chain import rotation_vector
from calibration_core.model.nominal import nominal_parameters
from calibration_core.timeseries import Readings

NOISE = 2e-5  # m
TILT = np.array([1.5e-3, -0.8e-3, 0.0])  # rad


def test_a_base_that_tilts_by_the_weight_is_no_tracker_that_stands_elsewhere(cell: Cell) -> None:
    """The robot's weight tilts the base alike in all postures; what was found says so."""
    readings = loaded_readings(cell, 3, 16)
    state = true_state(readings, cell)
    tilted = np.cross(TILT, state.point.T)
    moved = dataclasses.replace(
        readings, position=readings.position + tilted @ nominal_parameters(cell).tracker[:3, :3]
    )
    prepared = prepare_loaded(moved, cell, Options())
    every = np.arange(len(readings))
    assert [note.place for note in registration(prepared, state, moved)[1]] == [TRACKER]
    beside = refitted_frames(prepared, cell, prepared.fit.compliance, tilted, every)
    assert registration(prepared, state, moved, beside) == ((), ())
    unmoved = refitted_frames(prepared, cell, prepared.fit.compliance, 0 * tilted, every)
    (_, (still,)) = registration(prepared, state, moved, unmoved)
    assert still.place == TRACKER
    turned = re.search(r"turned by ([\d.]+) mrad", still.text)
    assert turned is not None
    assert float(turned[1]) == pytest.approx(1e3 * np.linalg.norm(TILT), rel=0.05)


def measured(cell: Cell, seed: int, configurations: int, geometry: np.ndarray, points: int = 3) -> Readings:
    """Return zero and half load of a robot whose frames before the joints are off by (6, 6) m and rad."""
    drawn = loaded_readings(cell, seed, configurations)
    chosen = drawn.select(np.flatnonzero((drawn.step < 2) & (drawn.point < points)))
    chosen = dataclasses.replace(chosen, points=chosen.points[:points])
    truth = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS), geometry=geometry)
    noise = NOISE * np.random.default_rng(seed).standard_normal(chosen.position.shape)
    return dataclasses.replace(chosen, position=predict_readings(chosen, cell, truth) + noise)


def test_frames_without_degrees_of_freedom_accuse_nobody(cell: Cell) -> None:
    """Three configurations and one target fix six numbers of the tracker and three of the target, and prove nothing."""
    for seed in range(3):
        found = diagnose(measured(cell, seed, 3, np.zeros((6, 6)), points=1), cell)
        assert found.findings == ()
        assert not [note for note in found.identification.notes if note.place in {TRACKER, TARGETS}]


def test_the_uncertainty_of_the_tracker_holds_what_the_geometry_does_to_it(cell: Cell) -> None:
    """Squares of a turn of three axes over its covariance are 3 on the average; geometry as usual, no tracker moved."""
    rng, squares = np.random.default_rng(5), []
    for seed in range(8):
        geometry = rng.standard_normal((6, 6)) * ([3e-4] * 3 + [1e-4] * 3)
        readings = measured(cell, seed, 12, geometry)
        frames = prepare_loaded(readings, cell, Options()).frames
        assert frames is not None
        turn = rotation_vector(frames.tracker[:3, :3] @ nominal_parameters(cell).tracker[:3, :3].T)
        squares.append(turn @ np.linalg.solve(frames.covariance[3:6, 3:6], turn))
        found = diagnose(readings, cell)
        assert (found.verdict, found.findings) == ("consistent", ())
    assert 1.0 < np.mean(squares) < 6.0


def test_a_target_that_stands_elsewhere_is_a_note_with_the_lines_for_the_cell_file(cell: Cell, tmp_path: Path) -> None:
    readings = measured(cell, 2, 12, np.zeros((6, 6)))
    stated = {name: list(at) for name, at in cell.frames.measurement_points.items()}
    stated["mp2"][1] += 2.5e-3
    found = diagnose(readings, write_cell(tmp_path, frames={"measurement_points": stated}))
    assert (found.verdict, found.findings) == ("consistent", ())
    (note,) = found.identification.notes
    assert (note.kind, note.place) == ("frames", TARGETS)
    away = re.match(r"mp2 is (2\.\d\d) mm \(± (0\.\d\d) mm\)", note.text)
    assert away is not None
    assert float(away[1]) == pytest.approx(2.5, abs=0.01)
    shown = found.identification.estimate
    std = [s for name, s in zip(shown.names, shown.std, strict=True) if name.startswith("measurement_points.mp2")]
    assert float(away[2]) == pytest.approx(1.96e3 * np.sqrt(np.mean(np.square(std))), abs=0.006)  # every ± holds 95 %
    lines = yaml.safe_load("{" + note.text.split("flange frame: ")[1].rstrip(".") + "}")
    assert lines["mp2"] == pytest.approx(cell.frames.measurement_points["mp2"], abs=1e-4)
    uncertain = write_cell(tmp_path, frames={"measurement_points": stated, "sigma_points": 2e-3})
    assert diagnose(readings, uncertain).identification.notes == ()  # as far off as the file says it may be


def test_a_turn_that_no_deflection_shows_is_a_note(cell: Cell, tmp_path: Path) -> None:
    """2 mrad turn a deflection of 2 mm by 4 micrometres, of which a tracker of 20 shows nothing."""
    stated = {"xyz": [4.0, 1.0, 1.2], "rpy": [0.012, -0.02, -2.9]}
    found = diagnose(measured(cell, 2, 12, np.zeros((6, 6))), write_cell(tmp_path, frames={"tracker": stated}))
    assert (found.verdict, found.findings) == ("consistent", ())
    (note,) = found.identification.notes
    assert note.place == TRACKER
    assert re.search(r"rpy: \[0\.0(10|099)", note.text)
