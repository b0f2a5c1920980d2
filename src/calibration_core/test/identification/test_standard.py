"""Equations (6) and (7) in blocks against a plain least-squares solution."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.identification import standard
from calibration_core.model.chain import Chain, rotation_rpy
from calibration_core.model.statics import Load


@pytest.mark.parametrize("n", [3, 6, 7])
def test_blocks_equal_one_least_squares_problem(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(n)
    chain = Chain(
        joints=tuple(map(str, range(n))),
        rotation=np.stack([rotation_rpy(*rng.uniform(-2, 2, 3)) for _ in range(n)]),
        translation=rng.uniform(-0.8, 0.8, (n, 3)),
        offset=np.zeros(n),
        flange_rotation=np.eye(3),
        flange_translation=np.array([0.0, 0.0, 0.2]),
        limits=np.tile([-3.0, 3.0], (n, 1)),
        gravity=np.array([0.0, 0.0, -9.8]),
    )
    m = 50
    q = rng.uniform(-2, 2, (m, n))
    load = Load(rng.normal(0, 1000, (3, m)), rng.normal(0, 100, (3, m)), np.array([0.0, 0.1, 0.1]), None)
    point, truth = np.array([0.1, 0.0, 0.2]), rng.uniform(2e-7, 3e-6, n)
    matrix = standard.observation_matrix(chain, q, load, point).transpose(2, 0, 1).reshape(-1, n)
    deflection = (matrix @ truth + rng.normal(0, 1e-5, 3 * m)).reshape(m, 3)
    monkeypatch.setattr(standard, "BLOCK", 7)
    fit = standard.fit_standard(chain, q, load, point, deflection)
    expected, rest, _, _ = np.linalg.lstsq(matrix, deflection.reshape(-1), rcond=None)
    np.testing.assert_allclose(fit.solution.value, expected, rtol=1e-7)
    assert fit.sigma == pytest.approx(np.sqrt(rest[0] / (3 * m - n)), rel=1e-6)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(matrix.T @ matrix) * fit.sigma**2, rtol=1e-6)
