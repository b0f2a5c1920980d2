"""The whole of an absolute identification: recovery, frames without a guess, several points, refusals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from absolute_cases import (
    ELBOW,
    POINTS,
    SEVEN,
    SIGMA,
    exact_positions,
    make_cell,
    make_readings,
    random_angles,
    truth_of,
)

from calibration_core.errors import CellError, IdentificationError
from calibration_core.identification.absolute.evaluate import identify_absolute
from calibration_core.identification.geometry.parameter_table import pose_by_twist
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.chain import pose_matrix, rotation_about, rpy_of

THREE_AXES = ((0.2, -np.pi / 2, 0.4), (0.7, 0.0, 0.0), (0.6, 0.0, 0.1))


@pytest.mark.parametrize("rows", [THREE_AXES, ELBOW, SEVEN], ids=["3 joints", "6 joints", "7 joints"])
@pytest.mark.parametrize("points", [("mp1",), tuple(POINTS)], ids=["1 point", "3 points"])
def test_positions_that_were_not_fitted_are_predicted_to_the_noise(rows: tuple, points: tuple[str, ...]) -> None:
    cell = make_cell(rows, points)
    truth = truth_of(cell, 1)
    n = len(rows)
    readings = make_readings(cell, truth, random_angles(2, 80, n))
    test = make_readings(cell, truth, random_angles(9, 30, n), noise=0.0, name="other.csv")
    result = identify_absolute(readings, cell, test=test)
    assert [stage.name for stage in result.stages] == ["nominal", "frames", "geometry", "elasticity"]
    assert [stage.kept for stage in result.stages] == [True, True, True, False]
    assert result.test is not None
    assert result.test.file == "other.csv"
    assert result.test.rms < 1.2 * SIGMA
    assert result.test.rms_before > 1e-3
    assert result.fit.rms_after < 1.05 * SIGMA < result.fit.held_out_rms_after * 1.1
    assert result.noise.scale < 1.1
    assert not result.exclusions
    np.testing.assert_allclose(predict_readings(test, cell, result.model), test.position, atol=6 * SIGMA)


def test_the_table_of_parameters() -> None:
    cell = make_cell()
    truth = truth_of(cell, 1, geometry=0.0)
    result = identify_absolute(make_readings(cell, truth, random_angles(2, 100, 6)), cell)
    table = {entry.name: entry for entry in result.parameters}
    expected = {
        **dict(zip(("tracker x", "tracker y", "tracker z"), truth.tracker[:3, 3], strict=True)),
        **dict(zip(("tracker roll", "tracker pitch", "tracker yaw"), rpy_of(truth.tracker[:3, :3]), strict=True)),
        **dict(zip(("mp1 x", "mp1 y", "mp1 z"), truth.points["mp1"], strict=True)),
    }
    for name, value in expected.items():
        assert table[name].fitted
        assert abs(table[name].value - value) < 4 * table[name].std, name
    assert table["tracker x"].nominal == 3.1
    assert table["d_3"].value == 0.0
    assert not table["d_3"].fitted
    assert np.isnan(table["d_3"].std)
    fitted = [entry for entry in result.parameters if entry.fitted]
    assert sorted(entry.name for entry in fitted) == sorted(result.names)
    assert all(result.covariance[k, k] == pytest.approx(table[name].std ** 2) for k, name in enumerate(result.names))
    assert {u.reason.split()[0] for u in result.unidentified} == {"d_1", "theta_1", "d_3", "d_6", "theta_6"}
    assert 1 < result.condition_number < 500


ABSURD = {"xyz": [-9, 9, 9], "rpy": [3, 1, -2]}


@pytest.mark.parametrize("guess", [None, {}, ABSURD], ids=["none", "identity", "absurd"])
def test_frames_need_no_guess(guess: dict | None) -> None:
    nominal = make_cell()
    truth = truth_of(nominal, 1)
    readings = make_readings(nominal, truth, random_angles(2, 80, 6))
    cell = make_cell(frames={"tracker": guess, "measurement_points": {"mp1": [0.0, 0.0, 0.6]}})
    result = identify_absolute(readings, cell)
    assert result.fit.rms_after < 1.05 * SIGMA
    assert (result.parameters[0].nominal is None) == (guess is None)
    assert result.stages[0].rms > result.stages[1].rms


def test_residuals_are_complete() -> None:
    cell = make_cell(points=tuple(POINTS))
    readings = make_readings(cell, truth_of(cell, 1), random_angles(2, 40, 6))
    residuals = identify_absolute(readings, cell).residuals
    np.testing.assert_allclose(residuals.measured - residuals.predicted, residuals.residual, atol=1e-15)
    assert residuals.held_out.shape == residuals.sigma.shape == (120, 3)
    assert np.std(residuals.held_out) > np.std(residuals.residual)
    np.testing.assert_allclose(residuals.sigma, SIGMA, rtol=0.1)
    assert not residuals.load.any()


def test_an_outlier_is_named_and_can_be_called_back() -> None:
    cell = make_cell()
    readings = make_readings(cell, truth_of(cell, 1), random_angles(2, 100, 6))
    position = readings.position.copy()
    position[41] += [0.0, 2e-3, 0.0]
    wrong = dataclasses.replace(readings, position=position)
    result = identify_absolute(wrong, cell)
    assert [(e.configuration, e.step, e.point) for e in result.exclusions] == [(42, 0, "mp1")]
    assert result.exclusions[0].size == pytest.approx(2e-3, rel=0.1)
    assert "limit" in result.exclusions[0].reason
    assert [anomaly.kind for anomaly in result.anomalies] == ["outlier_readings"]
    assert result.residuals.excluded[41]
    assert result.fit.rms_used < 1.05 * SIGMA < result.fit.rms_after
    for kept in (
        identify_absolute(wrong, cell, Options(robust=False)),
        identify_absolute(wrong, cell, Options(readmit=frozenset({(42, 0, "mp1")}))),
    ):
        assert not kept.exclusions
        assert kept.fit.rms_used > 3 * SIGMA


def test_a_spherical_tracker_weights_range_and_angle() -> None:
    claim = {"tracker": {"sigma_range": 5e-6, "sigma_angle": 3e-5}}
    cell = make_cell(instruments=claim)
    truth = truth_of(cell, 1)
    q = random_angles(2, 150, 6)
    exact = exact_positions(cell, truth, q, "mp1")
    rng = np.random.default_rng(0)
    reach = np.linalg.norm(exact, axis=1, keepdims=True)
    along = exact / reach
    across = rng.standard_normal(exact.shape)
    across -= np.sum(across * along, axis=1, keepdims=True) * along
    noise = 5e-6 * rng.standard_normal((150, 1)) * along + 3e-5 * reach * across
    readings = dataclasses.replace(make_readings(cell, truth, q), position=exact + noise)
    result = identify_absolute(readings, cell)
    assert result.noise.scale < 1.1
    assert 0.9 < np.sqrt(result.fit.chi2 / result.fit.degrees_of_freedom) < 1.1
    sight = along @ result.model.tracker[:3, :3].T
    assert np.std(np.sum(result.residuals.residual * sight, axis=1)) < 1.2e-5


def test_few_configurations_are_left_out_one_by_one() -> None:
    cell = make_cell()
    result = identify_absolute(make_readings(cell, truth_of(cell, 1), random_angles(2, 16, 6)), cell)
    assert result.stages[2].kept
    assert result.stages[2].held_out_rms > result.stages[2].rms
    scarce = identify_absolute(make_readings(cell, truth_of(cell, 1), random_angles(2, 5, 6)), cell)
    assert np.isfinite(scarce.fit.rms_after)


def test_the_answer_is_reproducible() -> None:
    cell = make_cell()
    readings = make_readings(cell, truth_of(cell, 1), random_angles(2, 60, 6))
    first, second = (identify_absolute(readings, cell) for _ in range(2))
    np.testing.assert_array_equal(first.covariance, second.covariance)
    np.testing.assert_array_equal(first.model.geometry, second.model.geometry)


def test_stiffness_of_the_cell_file_is_believed_until_shown_otherwise() -> None:
    stiff = {"stiffness": [2e6] * 6}
    cell = make_cell(robot=stiff)
    truth = truth_of(cell, 1, compliance=5e-7)
    result = identify_absolute(make_readings(cell, truth, random_angles(2, 100, 6)), cell)
    np.testing.assert_allclose(result.model.compliance, 5e-7)
    assert not result.stages[3].kept
    assert result.fit.rms_after < 1.05 * SIGMA


def test_a_recorded_load_bends_the_robot_too() -> None:
    sensor = {"xyz": [0.0, 0.0, 0.05], "rpy": [0.0, 0.0, 0.0]}
    cell = make_cell(robot={"stiffness": [2e6] * 6}, frames={"force_torque": sensor})
    readings = make_readings(cell, truth_of(cell, 1, compliance=5e-7), random_angles(2, 60, 6))
    wrench = np.tile([300.0, -200.0, 900.0, 0.0, 0.0, 0.0], (60, 1))
    loaded = dataclasses.replace(readings, wrench=wrench)
    with_load, without = identify_absolute(loaded, cell), identify_absolute(readings, cell)
    assert with_load.fit.rms_after > 2 * without.fit.rms_after  # the load was not there when the positions were made
    with pytest.raises(CellError, match=r"frames\.force_torque"):
        identify_absolute(loaded, make_cell())


def test_pose_by_twist() -> None:
    pose = pose_matrix(np.array([1.0, -2.0, 0.5]), np.array([0.3, -0.7, 2.0]))
    analytic = pose_by_twist(pose)
    for k in range(6):
        step = 1e-6 * np.eye(6)[k]
        moved = []
        for sign in (-1, 1):
            turn = rotation_about(sign * step[3:])
            moved.append(np.concatenate([turn @ pose[:3, 3] + sign * step[:3], rpy_of(turn @ pose[:3, :3])]))
        np.testing.assert_allclose(analytic[:, k], (moved[1] - moved[0]) / 2e-6, atol=1e-8)


def test_refusals() -> None:
    cell = make_cell()
    truth = truth_of(cell, 1)
    two = make_readings(cell, truth, random_angles(2, 2, 6))
    with pytest.raises(IdentificationError, match="found 2 configurations, expected at least 3"):
        identify_absolute(two, cell)
    three = make_readings(cell, truth, random_angles(2, 3, 6))
    with pytest.raises(IdentificationError, match="found 9 coordinates, expected more than the 9 parameters"):
        identify_absolute(three, cell)
    line = np.linspace(0, 1, 20)[:, None] * [1.0, 2.0, 0.5]
    collinear = dataclasses.replace(make_readings(cell, truth, random_angles(2, 20, 6)), position=line)
    with pytest.raises(IdentificationError, match="positions on one line"):
        identify_absolute(collinear, cell)
    relative = make_cell(measurements={"points": "displacement"})
    with pytest.raises(IdentificationError, match="displacement"):
        identify_absolute(make_readings(cell, truth, random_angles(2, 20, 6)), relative)
