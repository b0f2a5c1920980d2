"""What moves all points under the robot's own weight is no tracker that stands elsewhere."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from loaded_cases import true_state
from robots import loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis.findings.registration import registration_findings
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded, refitted_frames
from calibration_core.model.nominal import nominal_parameters

TILT = np.array([1.5e-3, -0.8e-3, 0.0])  # rad


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return write_cell(tmp_path_factory.mktemp("cell"))


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
    assert [one.effect for one in registration_findings(prepared, state, moved)] == ["tracker_frame_misalignment"]
    beside = refitted_frames(prepared, cell, prepared.fit.compliance, tilted, every)
    assert registration_findings(prepared, state, moved, beside) == ()
    unmoved = refitted_frames(prepared, cell, prepared.fit.compliance, 0 * tilted, every)
    (still,) = registration_findings(prepared, state, moved, unmoved)
    assert still.effect == "tracker_frame_misalignment"
    assert np.linalg.norm([one.value for one in still.parameters]) == pytest.approx(np.linalg.norm(TILT), rel=0.05)
