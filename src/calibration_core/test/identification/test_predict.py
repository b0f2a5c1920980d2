"""Predictions of an identified model against the readings it came from."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.errors import RecordingError
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.nominal import nominal_parameters


def test_the_true_model_predicts_to_the_noise(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    model = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS))
    readings = loaded_readings(cell, 1)
    error = readings.position - predict_readings(readings, cell, model)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(2e-5, rel=0.1)


def test_displacements_are_predicted_as_displacements(tmp_path: Path) -> None:
    cell = write_cell(tmp_path, measurements={"points": "displacement"})
    model = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS))
    readings = loaded_readings(cell, 2, noise=0.0)
    predicted = predict_readings(readings, cell, model)
    assert not predicted[readings.step == 0].any()
    absolute = write_cell(tmp_path)
    whole = predict_readings(readings, absolute, model)
    rows = (readings.configuration == 3) & (readings.point == 1)
    np.testing.assert_allclose(predicted[rows], whole[rows] - whole[rows][0], atol=1e-14)


def test_a_point_that_the_model_does_not_know_is_named(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    model = nominal_parameters(cell)
    readings = dataclasses.replace(loaded_readings(cell, 3), points=("mp1", "mp2", "elsewhere"))
    with pytest.raises(RecordingError, match="elsewhere"):
        predict_readings(readings, cell, model)
