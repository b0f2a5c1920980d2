"""Rows of a block left out are predicted as a fit without them predicts them."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.estimation.blocks import time_blocks
from calibration_core.estimation.columns import Columns, Effects
from calibration_core.estimation.leave_out import RIDGE, LeftOut, left_out, proof

READINGS, COLUMNS = 30, 7


@pytest.fixture(scope="module")
def example() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    ridge = np.array([0.0, 0.0, 0.0, 2.0, 2.0, 5.0, 5.0])
    return rng.standard_normal((3 * READINGS, COLUMNS)), rng.standard_normal(3 * READINGS), ridge


@pytest.mark.parametrize("count", [5, 15])
def test_both_ways_are_the_fit_without_the_block(
    example: tuple[np.ndarray, np.ndarray, np.ndarray], count: int
) -> None:
    """Blocks of 18 rows, more than there are columns, and of 6 rows, fewer."""
    columns, residual, ridge = example
    blocks = time_blocks(np.arange(READINGS), count)
    (quick,) = LeftOut(columns, residual, (blocks,), ridge).errors
    normal = columns.T @ columns + np.diag(ridge + RIDGE), columns.T @ residual
    slow = left_out(Columns(columns[:, :3], Effects.of(columns[:, 3:])), residual, blocks, normal)
    label = np.repeat(blocks.label, 3)
    for block in range(count):
        rest = label != block
        matrix = columns[rest].T @ columns[rest] + np.diag(ridge + RIDGE)
        expected = (residual - columns @ np.linalg.solve(matrix, columns[rest].T @ residual[rest]))[~rest]
        assert np.allclose(quick[~rest], expected)
        assert np.allclose(slow[~rest], expected)


def test_rows_of_priors_are_never_left_out(example: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    columns, residual, ridge = example
    blocks = time_blocks(np.arange(READINGS), 5)
    held = 40.0 * np.eye(COLUMNS)
    (seen,) = LeftOut(np.vstack([columns, held]), np.append(residual, np.zeros(COLUMNS)), (blocks,), ridge).errors
    (expected,) = LeftOut(columns, residual, (blocks,), ridge + 1600.0).errors
    assert np.allclose(seen[: 3 * READINGS], expected)


@pytest.mark.parametrize("further", [3, 60])
def test_further_columns_change_what_is_left_as_if_they_had_been_there(
    example: tuple[np.ndarray, np.ndarray, np.ndarray], further: int
) -> None:
    columns, residual, ridge = example
    more = np.random.default_rng(2).standard_normal((len(residual), further))
    columns, ridge = np.concatenate([columns[:, :4], more], axis=1), np.append(ridge[:4], np.full(further, 3.0))
    partitions = time_blocks(np.arange(READINGS), 5), time_blocks(np.arange(READINGS), 7)
    model = LeftOut(columns[:, :4], residual, partitions, ridge[:4])
    whole = LeftOut(columns, residual, partitions, ridge).errors
    for one, other in zip(model.beside(columns[:, 4:], ridge[4:]), whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("further", [0, 3, 60])
def test_scores_are_densities_of_a_block_given_the_others(
    example: tuple[np.ndarray, np.ndarray, np.ndarray], further: int
) -> None:
    columns, residual, ridge = example
    ridge, v = np.array([1e-3] * 3 + [2.0, 2.0, 5.0, 5.0]), 0.7
    more, more_ridge = np.random.default_rng(2).standard_normal((len(residual), further)), np.full(further, 3.0)
    blocks = time_blocks(np.arange(READINGS), 5)
    model = LeftOut(columns, residual, (blocks,), ridge)
    (seen,) = model.scores(v, more, more_ridge) if further else model.scores(v)
    wide, precision = np.concatenate([columns, more], axis=1), np.append(ridge, more_ridge)
    covariance = v * (np.eye(len(residual)) + (wide / precision) @ wide.T)
    label = np.repeat(blocks.label, 3)
    for block in range(5):
        out, rest = np.flatnonzero(label == block), np.flatnonzero(label != block)
        gain = covariance[np.ix_(out, rest)] @ np.linalg.inv(covariance[np.ix_(rest, rest)])
        left = covariance[np.ix_(out, out)] - gain @ covariance[np.ix_(rest, out)]
        error = residual[out] - gain @ residual[rest]
        density = -0.5 * (error @ np.linalg.solve(left, error) + np.linalg.slogdet(left / v)[1])
        assert -0.5 * seen[block] / v == pytest.approx(density, rel=1e-5, abs=1e-4)


def test_a_parameter_that_one_block_alone_shows_leaves_finite_errors() -> None:
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((3 * READINGS, 3))
    columns[:, 2] = 0.0
    columns[:18, 2] = 1e3 * rng.standard_normal(18)  # the first block's own, however large
    model = LeftOut(columns, rng.standard_normal(3 * READINGS), (time_blocks(np.arange(READINGS), 5),), np.zeros(3))
    others = model.errors[0][18:]
    plain = LeftOut(columns[:, :2], model.residual, model.partitions, np.zeros(2)).errors[0][18:]
    assert np.isfinite(model.errors[0]).all()
    assert np.abs(others).max() < 2 * np.abs(plain).max()


def test_what_a_single_block_saves_is_no_proof() -> None:
    before = np.array([10.0, 10.0, 50.0])
    assert not proof(before, np.array([10.5, 10.5, 10.0]), 1.0).holds
    assert proof(before, np.array([6.0, 6.0, 30.0]), 1.0).holds
    assert not proof(before, before - 1.0, 1.0).holds
