"""What is known already leaves the readings, and nothing else does."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.errors import ModelFileError, RecordingError
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.end_effector import without_effects
from calibration_core.identification.stiffness.predict import from_step_zero, predict_readings
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.timeseries import Readings

CREEP = AppliedEffect("creep", {"joint": "joint_2"}, "30 s", {"creep_share": 0.4})


def given(model: ModelParameters) -> GivenModel:
    return GivenModel(model, "model.yaml", "0" * 64)


def truth(cell: Cell, *effects: AppliedEffect) -> ModelParameters:
    return nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS), effects=effects)


def as_predicted(readings: Readings, cell: Cell, model: ModelParameters) -> Readings:
    return dataclasses.replace(readings, position=predict_readings(readings, cell, model))


@pytest.mark.parametrize("points", ["absolute", "displacement"])
def test_readings_less_the_effects_are_those_of_a_robot_without(points: str, tmp_path: Path) -> None:
    cell = write_cell(tmp_path, measurements={"points": points})
    readings = loaded_readings(cell, 1)
    model = truth(cell, CREEP)
    with_it = as_predicted(readings, cell, model)
    bare = as_predicted(readings, cell, model.replace(effects=()))
    assert np.abs(with_it.position - bare.position).max() > 3e-5
    freed = without_effects(with_it, cell, given(model))
    np.testing.assert_allclose(freed.position, bare.position, atol=1e-12)
    assert [note.kind for note in freed.notes] == ["known_effects"]
    if points == "displacement":
        np.testing.assert_allclose(freed.position, from_step_zero(freed, freed.position), atol=1e-15)


def test_a_model_without_effects_changes_nothing(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 1)
    assert without_effects(readings, cell, given(truth(cell))) is readings


def test_geometry_of_the_given_model_is_the_start_and_is_kept(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    geometry = np.zeros((6, 6))
    geometry[2, 5], geometry[3, 0] = 0.02, 0.015  # a degree and 15 mm: enough to bias stiffnesses
    model = truth(cell).replace(geometry=geometry)
    readings = as_predicted(loaded_readings(cell, 2), cell, model)
    bare = identify(readings, cell)
    found = identify(readings, cell, given=given(model))
    error, before = (
        np.abs(np.array([joint.value for joint in one.stiffness]) / STIFFNESS - 1).max() for one in (found, bare)
    )
    assert error < 1e-4 < 0.1 * before
    np.testing.assert_array_equal(found.model.geometry, geometry)
    np.testing.assert_allclose(predict_readings(readings, cell, found.model), readings.position, atol=1e-7)
    assert found.given is not None
    assert bare.given is None


def test_what_the_recording_has_no_data_for_is_refused_by_the_name_of_the_model(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 1)
    timeless = dataclasses.replace(readings, time=np.full(len(readings), np.nan))
    with pytest.raises(ModelFileError, match=r"^model\.yaml: effects: found creep"):
        without_effects(timeless, cell, given(truth(cell, CREEP)))


def test_a_point_that_the_model_does_not_know_is_refused_even_without_effects(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    model = truth(cell)
    some = model.replace(points={"mp1": model.points["mp1"]})
    with pytest.raises(RecordingError, match="mp2"):
        without_effects(loaded_readings(cell, 1), cell, given(some))
