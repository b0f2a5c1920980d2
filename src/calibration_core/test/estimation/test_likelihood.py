"""The restricted likelihood in condensed form is that of the dense model, and so are gains and their slopes."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.estimation.likelihood import Gram, Sizes, beside, fit_sizes, gains, price

ROWS, FLAT = 90, 4
BLOCKS = [np.arange(3), np.arange(3, 8)]
FURTHER = np.arange(8, 10)


def example(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residual (r,), flat columns (r, f) and columns (r, 10) with the first block present."""
    rng = np.random.default_rng(seed)
    columns, flat = rng.standard_normal((ROWS, 10)), rng.standard_normal((ROWS, FLAT))
    return columns[:, :3] @ rng.standard_normal(3) + 0.7 * rng.standard_normal(ROWS), flat, columns


def condensed(residual: np.ndarray, flat: np.ndarray, columns: np.ndarray) -> Gram:
    basis = np.linalg.qr(flat)[0]
    left, rest = columns - basis @ (basis.T @ columns), residual - basis @ (basis.T @ residual)
    return Gram(left.T @ left, left.T @ rest, float(rest @ rest), ROWS - FLAT)


def dense(residual: np.ndarray, flat: np.ndarray, columns: np.ndarray, sizes: Sizes, blocks: list) -> float:
    """Return the restricted log likelihood from the covariance of all contrasts (Patterson and Thompson 1971)."""
    contrast = np.linalg.svd(flat)[0][:, FLAT:]
    covariance = sizes.variance * np.eye(ROWS)
    for size, block in zip(sizes.size, blocks, strict=True):
        covariance = covariance + size**2 * columns[:, block] @ columns[:, block].T
    seen, inner = contrast.T @ residual, contrast.T @ covariance @ contrast
    return float(-0.5 * (np.linalg.slogdet(inner)[1] + seen @ np.linalg.solve(inner, seen)) - price(sizes.size).sum())


@pytest.mark.parametrize("seed", range(3))
def test_the_optimum_is_that_of_the_dense_likelihood(seed: int) -> None:
    residual, flat, columns = example(seed)
    found = fit_sizes(condensed(residual, flat, columns), BLOCKS)
    best = dense(residual, flat, columns, found, BLOCKS)
    assert found.value == pytest.approx(best, abs=1e-4)
    for factor in (0.8, 1.25):
        for k in range(3):
            variance = found.variance * (factor if k == 2 else 1.0)
            size = found.size * np.where(np.arange(2) == k, factor, 1.0)
            assert dense(residual, flat, columns, Sizes(variance, size, 0.0), BLOCKS) < best + 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_a_gain_is_what_the_dense_likelihood_grows_by(seed: int) -> None:
    residual, flat, columns = example(seed)
    gram = condensed(residual, flat, columns)
    found = fit_sizes(gram, BLOCKS[:1])
    matrix, vector = beside(gram, BLOCKS[:1], found)
    value, size = gains(matrix, vector[:, None], [BLOCKS[1], FURTHER])
    for k, block in enumerate((BLOCKS[1], FURTHER)):
        wider = Sizes(found.variance, np.append(found.size, size[k, 0]), 0.0)
        grown = dense(residual, flat, columns, wider, [BLOCKS[0], block])
        assert value[k, 0] == pytest.approx(grown - dense(residual, flat, columns, found, BLOCKS[:1]), abs=1e-6)


def test_sizes_beyond_what_is_typical_cost() -> None:
    assert price(np.array([0.1, 3.0])).tolist() == [0.0, 0.0]
    assert np.all(np.diff(price(np.array([3.0, 6.0, 12.0, 60.0]))) > 0)
