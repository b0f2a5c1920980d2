"""Points of a step as one displacement of the tool: the weighted least squares of each step by itself, however many."""

from __future__ import annotations

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.errors import IdentificationError
from calibration_core.identification.stiffness.fit import as_poses
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded
from calibration_core.identification.stiffness.problem import LoadedProblem

COMPLIANCE = 1 / np.array(STIFFNESS)


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> LoadedProblem:
    """Return a problem whose steps hold any number of readings: points are missing, or read several times."""
    cell = write_cell(tmp_path_factory.mktemp("cell"))
    whole = prepare_loaded(loaded_readings(cell, 1), cell, Options(robust=False)).problem
    rng = np.random.default_rng(5)
    return whole.select(np.sort(rng.integers(0, len(whole.readings), 2 * len(whole.readings))))


def test_steps_of_every_number_of_points_are_fitted_by_themselves(problem: LoadedProblem) -> None:
    linear = problem.linearise(COMPLIANCE)
    rows, residual, columns = as_poses(problem, linear)
    keys = np.column_stack([problem.configuration, problem.readings.step])
    points = {tuple(key): problem.readings.point[(keys == key).all(axis=1)] for key in np.unique(keys, axis=0)}
    kept = np.array([key for key, several in points.items() if len(set(several)) == 3])
    assert 0 < len(kept) < len(points)
    assert len({len(points[tuple(key)]) for key in kept}) > 2
    assert len(residual) == len(kept)
    np.testing.assert_array_equal(rows.configuration, np.unique(kept[:, 0], return_inverse=True)[1])
    for place, key in enumerate(kept):
        members = np.flatnonzero((keys == key).all(axis=1))
        at = linear.predicted[members]
        arms = at - at.mean(axis=0)
        design = np.concatenate([np.hstack([np.eye(3), -_cross(arm)]) for arm in arms])
        root = np.concatenate([np.linalg.inv(np.linalg.cholesky(linear.rows.noise[k])) for k in members])
        white = [root[3 * i : 3 * i + 3] @ design[3 * i : 3 * i + 3] for i in range(len(members))]
        data = [root[3 * i : 3 * i + 3] @ linear.residual[k] for i, k in enumerate(members)]
        expected, *_ = np.linalg.lstsq(np.concatenate(white), np.concatenate(data), rcond=None)
        np.testing.assert_allclose(residual[place], expected, rtol=1e-8, atol=1e-15)
        covariance = np.linalg.inv(sum(one.T @ one for one in white))
        np.testing.assert_allclose(rows.noise[place], covariance, rtol=1e-8, atol=1e-12 * covariance.max())
        by_compliance = np.linalg.lstsq(
            np.concatenate(white),
            np.concatenate([root[3 * i : 3 * i + 3] @ linear.columns[k] for i, k in enumerate(members)]),
            rcond=None,
        )[0]
        np.testing.assert_allclose(columns[place], by_compliance, rtol=1e-7, atol=1e-12 * np.abs(by_compliance).max())


def test_points_on_one_line_make_no_pose(problem: LoadedProblem) -> None:
    two = problem.select(np.flatnonzero(problem.readings.point < 2))
    with pytest.raises(IdentificationError, match="three such points"):
        as_poses(two, two.linearise(COMPLIANCE))


def _cross(arm: np.ndarray) -> np.ndarray:
    x, y, z = arm
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
