"""What readings share, whitened in closed form, is the dense covariance; offsets are the most probable ones."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.estimation.noise.whitening import Strata, whiten

SHARED, OFFSET = 0.7, 2.0


def strata() -> Strata:
    """Return two configurations of three steps and two points, and two of a single step, rows in mixed order."""
    keys = [(c, s, p) for c in (0, 2) for s in range(3) for p in range(2)] + [
        (c, 0, p) for c in (1, 3) for p in range(2)
    ]
    order = np.random.default_rng(4).permutation(len(keys))
    configuration, step, point = np.array(keys)[order].T
    return Strata(configuration, step, point, np.random.default_rng(5).standard_normal((len(keys), 3, 6)))


def dense(some: Strata) -> np.ndarray:
    same = some.configuration[:, None] == some.configuration
    step, point = (same & (one[:, None] == one) for one in (some.step, some.point))
    several = np.array([len(set(some.step[some.configuration == c])) > 1 for c in some.configuration])
    between = SHARED**2 * step + OFFSET**2 * (point & several)
    assert some.wrench is not None
    wrench = some.wrench.reshape(-1, 6)
    return np.eye(len(wrench)) + np.kron(between, np.eye(3)) + np.kron(step, np.ones((3, 3))) * (wrench @ wrench.T)


def test_the_square_root_of_the_inverse_covariance() -> None:
    some = strata()
    covariance = dense(some)
    whitening = whiten(some, SHARED, OFFSET)
    root = whitening(np.eye(len(covariance)))
    assert np.allclose(root.T @ root, np.linalg.inv(covariance))
    assert whitening.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1])


def test_offsets_are_the_most_probable_ones() -> None:
    some = strata()
    values = np.random.default_rng(6).standard_normal(3 * len(some.step))
    same = (some.configuration[:, None] == some.configuration) & (some.point[:, None] == some.point)
    several = np.array([len(set(some.step[some.configuration == c])) > 1 for c in some.configuration])
    offsets = OFFSET**2 * np.kron(same & several, np.eye(3)) @ np.linalg.solve(dense(some), values)
    assert np.allclose(whiten(some, SHARED, OFFSET).without_offsets(values), values - offsets)


def test_single_readings_are_left_as_they_are() -> None:
    one = np.zeros(4, dtype=np.int64)
    alone = whiten(Strata(np.arange(4), one, one, None), SHARED, OFFSET)
    assert alone.parts == ()
    assert np.array_equal(alone(np.eye(12)), np.eye(12))
