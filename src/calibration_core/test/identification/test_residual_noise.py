"""Noise or something systematic: what neighbouring postures tell."""

from __future__ import annotations

import numpy as np

from calibration_core.identification.absolute.gross_errors import NEIGHBOURS, audit_absolute, compare_neighbours

M, SIGMA = 600, 2e-5


def _postures(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (M, 3))


def _audit(residual: np.ndarray, q: np.ndarray):
    neighbours = compare_neighbours(q, residual, np.zeros(M, dtype=np.int64), np.arange(M))
    noise = np.tile(np.eye(3) * SIGMA**2, (M, 1, 1))
    return audit_absolute(noise, (None,), neighbours, float((residual**2).sum()) / SIGMA**2, 3 * M), neighbours


def test_white_noise_is_not_systematic() -> None:
    found = []
    for seed in range(100):
        residual = SIGMA * np.random.default_rng(seed).standard_normal((3, M))
        audit, neighbours = _audit(residual, _postures(seed))
        found.append(neighbours.systematic)
        assert audit.scale < 1.1
    assert np.mean(found) < 0.03


def test_noise_above_the_claim_is_understated() -> None:
    residual = 5 * SIGMA * np.random.default_rng(1).standard_normal((3, M))
    audit, _ = _audit(residual, _postures())
    assert audit.understated
    assert 4.7 < audit.scale < 5.3


def test_a_smooth_rest_is_not_called_noise() -> None:
    q = _postures()
    rng = np.random.default_rng(1)
    smooth = 1e-3 * np.stack([np.sin(q[:, 0]), np.cos(q[:, 1]), np.sin(q[:, 2])])
    residual = smooth + SIGMA * rng.standard_normal((3, M))
    audit, neighbours = _audit(residual, q)
    assert neighbours.systematic
    assert not audit.understated
    assert audit.scale > 10
    assert "depends on posture" in audit.text
    check = next(check for check in audit.checks if check.source == NEIGHBOURS)
    assert SIGMA / 2 < check.seen < 1e-4


def test_repeats_that_scatter_prove_understated_noise_beside_a_smooth_rest() -> None:
    q = np.repeat(_postures()[: M // 2], 2, axis=0)
    rng = np.random.default_rng(1)
    residual = 1e-3 * np.sin(q.T) + 5 * SIGMA * rng.standard_normal((3, M))
    audit, neighbours = _audit(residual, q)
    assert neighbours.systematic
    assert audit.understated
    assert "repeats" in audit.text


def test_few_readings_say_nothing() -> None:
    q = _postures()[:20]
    assert compare_neighbours(q, q.T, np.zeros(20, dtype=np.int64), np.arange(20)) is None
    same = np.zeros(M, dtype=np.int64)
    assert compare_neighbours(_postures(), _postures().T, same, same) is None  # one configuration only
