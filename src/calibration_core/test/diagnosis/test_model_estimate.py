"""The covariance of an extended model is that of everything in it together, and covers the truth."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from loaded_cases import TRUE, planted
from robots import STIFFNESS, loaded_readings

from calibration_core.cell import Cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import model_text, read_calibrated
from calibration_core.model.identified.named_values import value_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Readings

BEARING = [2.5e-7, 1.2e-7, 0.5e-7]
SINE, COSINE = 1.0e-4, 2.5e-4  # rad
WAVE = AppliedEffect("transmission_error", {"joint": "joint_3"}, "order 2", {"sine": SINE, "cosine": COSINE})
SEEDS = (5, 7, 8, 9)


def groups(estimate: GaussianEstimate) -> set[str]:
    return {name.partition(".")[0] for name in estimate.names}


def correlation(estimate: GaussianEstimate, rows: list[int], columns: list[int]) -> np.ndarray:
    std = estimate.std
    return estimate.covariance[np.ix_(rows, columns)] / np.outer(std[rows], std[columns])


def test_compliances_and_effects_together_cover_the_truth(cell: Cell) -> None:
    squares = []
    for seed in SEEDS:
        found = diagnose_loaded(planted(cell, seed, "off_axis_compliance", "before", BEARING, joint="joint_2"), cell)
        if [one.variant for one in found.findings] != ["before"]:
            continue  # the same bearing in other axes: its parameters are other ones
        estimate = found.estimate
        own = [k for k, name in enumerate(estimate.names) if name.startswith(("compliance.", "effects."))]
        assert len(own) == 9
        error = estimate.value[own] - np.concatenate([TRUE, BEARING])
        squares.append(float(error @ np.linalg.solve(estimate.covariance[np.ix_(own, own)], error)))
        assert np.abs(correlation(estimate, own[:6], own[6:])).max() > 0.2
        assert found.model is not None
        for name, value in zip(estimate.names, estimate.value, strict=True):
            assert value_of(found.model, name) == pytest.approx(value, rel=1e-9)
    assert len(squares) >= 3
    # Chi squares of 9 degrees of freedom: 9, standard deviation sqrt(18 / number).
    assert np.mean(squares) == pytest.approx(9.0, abs=4 * np.sqrt(18 / len(squares)))


@pytest.fixture(scope="module")
def mixed(cell: Cell) -> Diagnosis:
    """The diagnosis of loads on a bearing that tilts, and of single steps of a gear error."""
    loaded = planted(cell, 5, "off_axis_compliance", "before", BEARING, joint="joint_2")
    readings = loaded_readings(cell, 6, 40)
    single = readings.select(readings.step == 0)
    bearing = dict(zip(("compliance_x", "compliance_y", "compliance_xy"), BEARING, strict=True))
    tilting = AppliedEffect("off_axis_compliance", {"joint": "joint_2"}, "before", bearing)  # feels the weight, too
    model = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS), effects=(tilting, WAVE))
    moved = predict_readings(single, cell, model) - predict_readings(single, cell, model.replace(effects=()))
    single = dataclasses.replace(
        single, position=single.position + moved, configuration=single.configuration + 100, time=single.time + 1e4
    )
    both = {
        field.name: np.concatenate([getattr(loaded, field.name), getattr(single, field.name)])
        for field in dataclasses.fields(Readings)
        if isinstance(getattr(loaded, field.name), np.ndarray) and getattr(loaded, field.name).ndim
    }
    return diagnose(dataclasses.replace(loaded, **both), cell)


def test_effects_of_loads_and_of_single_steps_stand_in_one_covariance(
    mixed: Diagnosis, cell: Cell, tmp_path: Path
) -> None:
    assert {one.effect for one in mixed.findings} >= {"off_axis_compliance", "transmission_error"}
    assert mixed.model is not None
    estimate = mixed.estimate
    fitted = {"geometry"} if np.any(mixed.model.geometry) else set()  # where it predicts blocks left out better
    assert groups(estimate) == {"tracker", "measurement_points", "compliance", "effects"} | fitted
    for name, value in zip(estimate.names, estimate.value, strict=True):
        assert value_of(mixed.model, name) == pytest.approx(value, rel=1e-9)
    path = tmp_path / "model.yaml"
    path.write_text(model_text(mixed.model, cell, estimate))
    again = read_calibrated(path, cell).estimate  # refuses what is no covariance
    assert again is not None
    np.testing.assert_array_equal(again.covariance, estimate.covariance)
    of = {key: [k for k, name in enumerate(estimate.names) if name.startswith(key)] for key in groups(estimate)}
    assert np.abs(correlation(estimate, of["effects"], of["compliance"])).max() > 0.2
    for joint, true in zip(cell.robot.joints, TRUE, strict=True):
        k = estimate.names.index(f"compliance.{joint}")
        assert abs(estimate.value[k] - true) < 4 * estimate.std[k]


def test_a_single_loaded_configuration_beside_single_steps_is_searched_with_them(cell: Cell) -> None:
    """One loaded configuration tells no stiffness, and takes nothing from what the others tell."""
    readings = loaded_readings(cell, 6, 41)
    readings = readings.select((readings.step == 0) | (readings.configuration == readings.configuration[0]))
    model = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS), effects=(WAVE,))
    moved = predict_readings(readings, cell, model) - predict_readings(readings, cell, model.replace(effects=()))
    found = diagnose(dataclasses.replace(readings, position=readings.position + moved), cell)
    assert [(one.effect, one.location) for one in found.findings] == [(WAVE.effect, WAVE.location)]
