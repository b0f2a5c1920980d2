"""Rows of a block left out are predicted as a fit without them predicts them."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.estimation.blocks import time_blocks
from calibration_core.estimation.leave_out import RIDGE, left_out, left_out_blocks, proof

READINGS, COLUMNS = 30, 7


@pytest.fixture(scope="module")
def example() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    ridge = np.array([0.0, 0.0, 0.0, 2.0, 2.0, 5.0, 5.0])
    return rng.standard_normal((3 * READINGS, COLUMNS)), rng.standard_normal(3 * READINGS), ridge


def test_both_ways_are_the_fit_without_the_block(example: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    columns, residual, ridge = example
    blocks = time_blocks(np.arange(READINGS), 5)
    (quick,) = left_out_blocks(columns, residual, (blocks,), ridge)
    slow = left_out(columns, residual, blocks, ridge)
    label = np.repeat(blocks.label, 3)
    for block in range(5):
        rest = label != block
        matrix = columns[rest].T @ columns[rest] + np.diag(ridge + RIDGE)
        expected = (residual - columns @ np.linalg.solve(matrix, columns[rest].T @ residual[rest]))[~rest]
        assert np.allclose(quick[~rest], expected)
        assert np.allclose(slow[~rest], expected)


def test_rows_of_priors_are_never_left_out(example: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    columns, residual, ridge = example
    blocks = time_blocks(np.arange(READINGS), 5)
    held = 40.0 * np.eye(COLUMNS)
    (seen,) = left_out_blocks(np.vstack([columns, held]), np.append(residual, np.zeros(COLUMNS)), (blocks,), ridge)
    (expected,) = left_out_blocks(columns, residual, (blocks,), ridge + 1600.0)
    assert np.allclose(seen[: 3 * READINGS], expected)


def test_what_a_single_block_saves_is_no_proof() -> None:
    before = np.array([10.0, 10.0, 50.0])
    assert not proof(before, np.array([10.5, 10.5, 10.0]), 1.0).holds
    assert proof(before, np.array([6.0, 6.0, 30.0]), 1.0).holds
    assert not proof(before, before - 1.0, 1.0).holds
