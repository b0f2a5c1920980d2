"""The joint covariance of what was identified covers the truth, wherever the model predicts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from absolute_cases import SIGMA, make_cell, make_readings, random_angles, truth_of
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.geometry.parameter_table import frames_uncertainty, with_known_effects
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.chain import rotation_about, rotation_rpy, rpy_of
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import value_of, with_values
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float2D, Readings

STEP = 0.1  # standard deviations
RECORDINGS = 25


def predicted_sigma(readings: Readings, cell: Cell, model: ModelParameters, estimate: GaussianEstimate) -> Float2D:
    """Return the (m, 3) m standard deviations of predicted positions, by differences along the covariance's root."""
    root = estimate.root()
    total = np.zeros((len(readings), 3))
    for column in root.T:
        ends = [
            with_values(model, dict(zip(estimate.names, estimate.value + sign * STEP * column, strict=True)))
            for sign in (1, -1)
        ]
        first, second = (predict_readings(readings, cell, end) for end in ends)
        total += ((first - second) / (2 * STEP)) ** 2
    return np.asarray(np.sqrt(total))


def test_intervals_of_absolute_positions_cover_the_truth() -> None:
    cell = make_cell(points=("mp1", "mp2", "mp3"))
    inside, expected = [], 0.0
    for seed in range(1, 10):
        truth = truth_of(cell, seed)
        found = identify(make_readings(cell, truth, random_angles(seed + 100, 30, 6), seed=seed), cell)
        assert found.stages[2].kept
        other = make_readings(cell, truth, random_angles(seed + 300, 6, 6), noise=0.0)
        sigma = predicted_sigma(other, cell, found.model, found.estimate)
        error = predict_readings(other, cell, found.model) - other.position
        inside.append(np.mean(np.abs(error) < 1.96 * sigma))
        expected = max(expected, float(sigma.max()))
        assert {name.partition(".")[0] for name in found.estimate.names} == {
            "tracker", "measurement_points", "geometry"
        }  # fmt: skip
    assert 0.90 <= np.mean(inside) <= 0.99
    assert expected < 2 * SIGMA


def test_intervals_of_stiffness_cover_the_truth(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    squares = []
    for seed in range(RECORDINGS):
        found = identify(loaded_readings(cell, seed), cell)
        own = [k for k, name in enumerate(found.estimate.names) if name.startswith("compliance.")]
        estimate = found.estimate.chosen(own)
        assert estimate.names == tuple(f"compliance.{joint}" for joint in cell.robot.joints)
        assert set(estimate.units) == {"rad/(N*m)"}
        error = estimate.value - 1 / np.array(STIFFNESS)
        squares.append(float(error @ np.linalg.solve(estimate.covariance, error)))
    # The mean of 25 chi squares of 6 degrees of freedom: 6, standard deviation sqrt(12 / 25).
    assert np.mean(squares) == pytest.approx(6.0, abs=4 * np.sqrt(12 / RECORDINGS))


def test_the_table_of_frames_states_the_uncertainty_of_the_model_that_is_written(tmp_path: Path) -> None:
    """Roll, pitch and yaw of a tracker that stands askew are not the rotations about the axes of the base."""
    cell = write_cell(tmp_path)
    found = identify(loaded_readings(cell, 1), cell)
    std = dict(zip(found.estimate.names, np.sqrt(np.diag(found.estimate.covariance)), strict=True))
    table = {one.name: one for one in found.parameters if one.group == "tracker"}
    assert abs(table["tracker yaw"].value) > 0.1
    for part in ("x", "y", "z", "roll", "pitch", "yaw"):
        assert table[f"tracker {part}"].std == pytest.approx(std[f"tracker.{part}"], rel=1e-9)


def test_roll_pitch_and_yaw_scatter_as_the_rotations_that_were_fitted() -> None:
    rng = np.random.default_rng(4)
    root = rng.standard_normal((9, 9)) * 1e-4
    tracker = np.eye(4)
    tracker[:3, :3] = rotation_rpy(0.3, -0.7, 2.6)
    stated = frames_uncertainty(FrameFit(tracker, np.zeros((1, 3)), root @ root.T, 0.0, 9, 0 * root, 0), ["mp1"])
    drawn = rng.standard_normal((20_000, 9)) @ root.T
    turned = np.array([rpy_of(rotation_about(one) @ tracker[:3, :3]) for one in drawn[:, 3:6]])
    seen = np.cov(np.column_stack([drawn[:, :3], turned, drawn[:, 6:]]).T)
    scale = np.sqrt(np.diag(seen))
    np.testing.assert_allclose(stated.covariance / np.outer(scale, scale), seen / np.outer(scale, scale), atol=0.04)


def test_the_estimate_is_that_of_the_model_as_it_is_written(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    found = identify(loaded_readings(cell, 1), cell)
    assert len(found.estimate.names) == 6 + 6 + 3 * len(cell.points)
    for name, value in zip(found.estimate.names, found.estimate.value, strict=True):
        assert value_of(found.model, name) == pytest.approx(value, rel=1e-12)
    table = {entry.name: entry.std for entry in found.parameters}
    assert found.estimate.std[found.estimate.names.index("tracker.x")] == pytest.approx(table["tracker x"])


def test_effects_known_before_come_first_and_keep_their_covariance() -> None:
    own = GaussianEstimate(("compliance.a", "effects.0.x"), ("1", "1"), np.ones(2), np.eye(2))
    known = GaussianEstimate(("tracker.x", "effects.1.y"), ("m", "1"), np.ones(2), np.array([[2.0, 1.0], [1.0, 3.0]]))
    both = with_known_effects(own, known, 2)
    assert both.names == ("compliance.a", "effects.2.x", "effects.1.y")
    assert np.diag(both.covariance).tolist() == [1.0, 1.0, 3.0]
    assert with_known_effects(own, None, 2).names == ("compliance.a", "effects.2.x")
