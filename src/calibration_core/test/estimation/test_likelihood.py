"""The restricted likelihood in condensed form is that of the dense model, and so are gains and their slopes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from calibration_core.estimation.likelihood.gains import Grouped, beside, chance_gain, gains
from calibration_core.estimation.likelihood.restricted import DEAR, WIDE, Gram, Likelihood, Sizes, fit_sizes, price

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
    return Gram(left.T @ left, left.T @ rest, float(rest @ rest), len(residual) - FLAT)


def dense(residual: np.ndarray, flat: np.ndarray, columns: np.ndarray, sizes: Sizes, blocks: list) -> float:
    """Return the restricted log likelihood from the covariance of all contrasts (Patterson and Thompson 1971)."""
    contrast = np.linalg.svd(flat)[0][:, FLAT:]
    covariance = sizes.variance * np.eye(len(residual))
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


@pytest.mark.parametrize("wide", [5, WIDE + 4])
def test_slopes_are_finite_differences_and_the_information_is_that_of_the_covariance(wide: int) -> None:
    """Of two blocks as columns, and of a wide one by its eigenvectors; one size is beyond what is typical."""
    rng = np.random.default_rng(11)
    columns, residual = rng.standard_normal((3 * WIDE, wide + 4)), rng.standard_normal(3 * WIDE)
    blocks = [np.arange(4), np.arange(4, wide + 4)]
    gram = Gram(columns.T @ columns, columns.T @ residual, float(residual @ residual), len(residual))
    x = np.log([0.8, 4.0, 0.3])

    at, step = Likelihood(gram, blocks).at, 1e-5
    found = at(x)
    for k, change in enumerate(step * np.eye(3)):
        assert found.slope[k] == pytest.approx((at(x + change).value - at(x - change).value) / (2 * step), abs=1e-5)
    variance, size = np.exp(x[0]), np.exp(x[1:])
    parts = [2 * t**2 * columns[:, block] @ columns[:, block].T for t, block in zip(size, blocks, strict=True)]
    changes = [variance * np.eye(len(residual)), *parts]  # of the covariance with every logarithm
    precision = np.linalg.inv(changes[0] + 0.5 * sum(parts))
    along = np.stack([change @ precision @ residual for change in changes])
    paid = np.diag([0.0, 1 / DEAR**2, 0.0])
    expected = 0.5 * along @ precision @ along.T + paid
    unit = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))  # two that have hardly anything in common are near 0
    np.testing.assert_allclose(found.information / unit, expected / unit, rtol=0, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_a_gain_is_what_the_dense_likelihood_grows_by(seed: int) -> None:
    residual, flat, columns = example(seed)
    gram = condensed(residual, flat, columns)
    found = fit_sizes(gram, BLOCKS[:1])
    gained = gains(beside(gram, BLOCKS[:1], found), Grouped.of([BLOCKS[1], FURTHER]))
    for k, block in enumerate((BLOCKS[1], FURTHER)):
        left = float(gained.left[k, 0])
        assert 0 < left <= 1
        size = np.append(found.size, gained.size[k, 0]) * np.sqrt(left)
        grown = dense(residual, flat, columns, Sizes(found.variance * left, size, 0.0), [BLOCKS[0], block])
        assert gained.nats[k, 0] == pytest.approx(grown - dense(residual, flat, columns, found, BLOCKS[:1]), abs=1e-6)


@pytest.mark.parametrize(("few", "at"), [(0, 0), (5, 0), (5, 1)])
def test_a_wide_block_beside_others_is_as_the_dense_likelihood(few: int, at: int) -> None:
    """The eigenvectors of the wide block alone serve: its sizes and gains are those of the covariance itself."""
    rng = np.random.default_rng(7)
    rows, wide = 3 * WIDE, WIDE + 4
    columns, flat = rng.standard_normal((rows, wide + few)), rng.standard_normal((rows, FLAT))
    residual = 0.1 * columns @ rng.standard_normal(wide + few) + 0.7 * rng.standard_normal(rows)
    begins = (0, wide) if at == 0 else (few, 0)
    blocks = [np.arange(begins[0], begins[0] + wide)]
    if few:
        blocks.insert(1 - at, np.arange(begins[1], begins[1] + few))
    basis = np.linalg.qr(flat)[0]
    left, rest = columns - basis @ (basis.T @ columns), residual - basis @ (basis.T @ residual)
    gram = Gram(left.T @ left, left.T @ rest, float(rest @ rest), rows - FLAT)
    found = fit_sizes(gram, blocks)
    best = dense(residual, flat, columns, found, blocks)
    assert found.value == pytest.approx(best, abs=1e-4)
    for k, factor in itertools.product(range(len(blocks) + 1), (0.8, 1.25)):
        variance = found.variance * (factor if k == len(blocks) else 1.0)
        size = found.size * np.where(np.arange(len(blocks)) == k, factor, 1.0)
        assert dense(residual, flat, columns, Sizes(variance, size, 0.0), blocks) < best + 1e-3
    others = [block for block in blocks if len(block) < WIDE]
    before = fit_sizes(gram, others)
    gained = gains(beside(gram, others, before), Grouped.of([max(blocks, key=len)]))
    share = float(gained.left[0, 0])
    size = np.append(before.size, gained.size[0, 0]) * np.sqrt(share)
    grown = dense(residual, flat, columns, Sizes(before.variance * share, size, 0.0), [*others, max(blocks, key=len)])
    assert gained.nats[0, 0] == pytest.approx(grown - dense(residual, flat, columns, before, others), abs=1e-6)


def test_sizes_beyond_what_is_typical_cost() -> None:
    assert price(np.array([0.1, 3.0])).tolist() == [0.0, 0.0]
    assert np.all(np.diff(price(np.array([3.0, 6.0, 12.0, 60.0]))) > 0)


def test_one_recording_of_noise_in_a_hundred_gains_more_than_chance_does() -> None:
    _, flat, columns = example(0)
    blocks, recordings = Grouped.of([*BLOCKS, FURTHER]), 1500
    limit = chance_gain(condensed(np.zeros(ROWS), flat, columns), np.ones(10, dtype=bool), blocks, 240)
    rng, beyond = np.random.default_rng(9), 0
    for _ in range(recordings):
        gram = condensed(rng.standard_normal(ROWS), flat, columns)
        beyond += gains(beside(gram, [], Sizes(1.0, np.zeros(0), 0.0)), blocks).nats.max() > limit
    assert 0.004 < beyond / recordings < 0.025


@pytest.mark.parametrize(("rows", "width"), [(34, 2), (34, 26), (34, 40)])
def test_what_chance_gains_is_what_drawn_recordings_gain(rows: int, width: int) -> None:
    """Also of a block as wide as there are degrees of freedom, as friction is of one target in two steps."""
    rng, recordings = np.random.default_rng(9), 400
    columns, flat = rng.standard_normal((rows, 8 + width)), rng.standard_normal((rows, FLAT))
    blocks = Grouped.of([*BLOCKS, np.arange(8, 8 + width)])
    limit = chance_gain(condensed(np.zeros(rows), flat, columns), np.ones(8 + width, dtype=bool), blocks, 240)
    drawn = (condensed(rng.standard_normal(rows), flat, columns) for _ in range(recordings))
    largest = np.array([gains(beside(one, [], Sizes(1.0, np.zeros(0), 0.0)), blocks).nats.max() for one in drawn])
    assert limit == pytest.approx(np.quantile(largest, 0.99), abs=1.2)  # both scatter by 0.4 nats
