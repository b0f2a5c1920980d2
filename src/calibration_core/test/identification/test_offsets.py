"""Free offsets: equal to generalised least squares on differences, whatever the grouping."""

from __future__ import annotations

import dataclasses
import weakref

import numpy as np
import pytest

from calibration_core.identification.statistics import (
    Rows,
    deleted,
    normal_equations,
    whitened,
    without_offsets,
)


def _rows(rng: np.random.Generator, configurations: int = 3, steps: int = 4, points: int = 2) -> Rows:
    grid = np.array([(c, s, p) for c in range(configurations) for s in range(steps) for p in range(points)])
    m = len(grid)
    factor = rng.normal(size=(m, 3, 3)) * 1e-5
    noise = factor @ factor.transpose(0, 2, 1) + np.eye(3) * 1e-10
    return Rows(grid[:, 0], grid[:, 2], grid[:, 0] * steps + grid[:, 1], noise, rng.normal(size=(m, 3, 6)) * 1e-5)


def _dense(rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Return the full covariance and the offsets' design matrix, written down directly."""
    m = len(rows.configuration)
    covariance = np.zeros((3 * m, 3 * m))
    for i in range(m):
        for j in range(m):
            block = rows.shared[i] @ rows.shared[j].T if rows.load[i] == rows.load[j] else np.zeros((3, 3))
            covariance[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block + (rows.noise[i] if i == j else 0.0)
    keys = sorted({(c, o) for c, o in zip(rows.configuration, rows.offset, strict=True)})
    design = np.zeros((3 * m, 3 * len(keys)))
    for i, key in enumerate(zip(rows.configuration, rows.offset, strict=True)):
        k = keys.index(key)
        design[3 * i : 3 * i + 3, 3 * k : 3 * k + 3] = np.eye(3)
    return covariance, design


def test_the_same_rows_are_the_same_value_with_what_is_known_of_them() -> None:
    rows = _rows(np.random.default_rng(4))
    some = np.arange(5, 20)
    assert rows.select(some) is rows.select(some.copy())
    assert rows.select(some) is not rows.select(some[1:])
    assert rows.select(np.arange(len(rows.configuration))) is rows
    used = np.ones(len(rows.configuration), dtype=bool)
    assert rows.counting(used) is rows
    used[3] = False
    assert rows.counting(used) is rows.counting(np.flatnonzero(used))
    assert rows.counting(used).noise[3, 0, 0] > 1e9 * rows.noise[3, 0, 0]
    np.testing.assert_array_equal(rows.counting(used).noise[used], rows.noise[used])


@pytest.mark.parametrize("shuffled", [False, True])
def test_normal_equations_equal_the_full_problem(shuffled: bool) -> None:
    rng = np.random.default_rng(1)
    rows = _rows(rng)
    if shuffled:
        rows = rows.select(rng.permutation(len(rows.configuration))[:-3])  # incomplete configurations too
    m = len(rows.configuration)
    residual, columns = rng.normal(size=(m, 3)), rng.normal(size=(m, 3, 5))
    normal = normal_equations(rows, residual, columns)

    covariance, design = _dense(rows)
    weight = np.linalg.inv(covariance)
    full = np.hstack([columns.reshape(3 * m, 5), design])
    matrix = full.T @ weight @ full
    reduced = matrix[:5, :5] - matrix[:5, 5:] @ np.linalg.solve(matrix[5:, 5:], matrix[5:, :5])
    np.testing.assert_allclose(normal.matrix.sum(0), reduced, rtol=1e-9)
    right = full.T @ weight @ residual.reshape(-1)
    expected = right[:5] - matrix[:5, 5:] @ np.linalg.solve(matrix[5:, 5:], right[5:])
    np.testing.assert_allclose(normal.vector.sum(0), expected, rtol=1e-8, atol=1e-6 * np.abs(expected).max())
    assert normal.freedom.sum() == 3 * m - design.shape[1]


@pytest.mark.parametrize("shuffled", [False, True])
def test_whitened_rows_have_the_products_of_the_normal_equations(shuffled: bool) -> None:
    rng = np.random.default_rng(2)
    rows, places = _rows(rng), None
    data = rng.normal(size=(len(rows.configuration), 3, 5))
    if shuffled:
        places = rng.permutation(len(rows.configuration))[:-3]
        rows = rows.select(places)
    own = data if places is None else data[places]
    white, configuration = whitened(rows, data, places)
    normal = normal_equations(rows, own[:, :, -1], own[:, :, :-1])
    np.testing.assert_array_equal(configuration, np.repeat(np.arange(len(normal.freedom)), normal.freedom))
    for k, (matrix, vector) in enumerate(zip(normal.matrix, normal.vector, strict=True)):
        part = white[configuration == k]
        np.testing.assert_allclose(part[:, :-1].T @ part[:, :-1], matrix, rtol=1e-9, atol=1e-6 * np.abs(matrix).max())
        np.testing.assert_allclose(part[:, :-1].T @ part[:, -1], vector, rtol=1e-9, atol=1e-6 * np.abs(matrix).max())


def test_two_readings_with_one_offset_are_one_difference() -> None:
    sigma = 3e-5
    rows = Rows(
        np.zeros(2, int), np.zeros(2, int), np.arange(2), np.tile(np.eye(3) * sigma**2, (2, 1, 1)), np.zeros((2, 3, 0))
    )
    residual = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    columns = np.array([np.zeros((3, 1)), np.ones((3, 1))])
    normal = normal_equations(rows, residual, columns)
    np.testing.assert_allclose(normal.matrix[0], [[3 / (2 * sigma**2)]])  # a difference has twice the variance
    np.testing.assert_allclose(normal.vector[0], [6 / (2 * sigma**2)])
    np.testing.assert_allclose(without_offsets(rows, residual), [[-0.5, -1, -1.5], [0.5, 1, 1.5]], atol=1e-12)


def test_deleted_predicts_a_row_from_the_others() -> None:
    rng = np.random.default_rng(2)
    rows = _rows(rng, configurations=1)
    residual = rng.normal(size=(len(rows.configuration), 3)) * 1e-5
    squared, error, covariance = deleted(rows, residual)
    full, design = _dense(rows)
    i, others = 5, [k for k in range(len(residual)) if k != 5]
    keep = np.concatenate([np.arange(3 * k, 3 * k + 3) for k in others])
    own = np.arange(3 * i, 3 * i + 3)
    weight = np.linalg.inv(full[np.ix_(keep, keep)])
    offsets = np.linalg.solve(design[keep].T @ weight @ design[keep], design[keep].T @ weight)
    flat = residual.reshape(-1)
    best = offsets @ flat[keep]
    gain = full[np.ix_(own, keep)] @ weight
    predicted = design[own] @ best + gain @ (flat[keep] - design[keep] @ best)
    np.testing.assert_allclose(error[i], flat[own] - predicted, rtol=1e-7, atol=1e-16)
    np.testing.assert_allclose(squared[i], error[i] @ np.linalg.solve(covariance[i], error[i]), rtol=1e-9)


@pytest.mark.parametrize("aside", [[3], [0, 1, 2], [0, 7, 8], list(range(5))])
def test_rows_without_some_are_those_that_are_selected_afresh(aside: list[int]) -> None:
    rng = np.random.default_rng(11)
    rows = _rows(rng, configurations=3)
    m = len(rows.configuration)
    residual, columns = rng.normal(size=(m, 3)) * 1e-5, rng.normal(size=(m, 3, 2))
    left, stays = rows.without(np.array(aside)), np.setdiff1d(np.arange(m), aside)
    again = Rows(*(getattr(rows, field.name)[stays] for field in dataclasses.fields(rows)))
    for one, other in zip(deleted(left, residual[stays]), deleted(again, residual[stays]), strict=True):
        np.testing.assert_array_equal(one, other)
    normal, afresh = (normal_equations(each, residual[stays], columns[stays]) for each in (left, again))
    np.testing.assert_allclose(normal.matrix, afresh.matrix, rtol=1e-12)
    np.testing.assert_allclose(normal.vector, afresh.vector, rtol=1e-12)
    twice = left.without(np.array([len(stays) - 1]))
    np.testing.assert_array_equal(
        deleted(twice, residual[stays[:-1]])[0],
        deleted(again.select(np.arange(len(stays) - 1)), residual[stays[:-1]])[0],
    )


def test_rows_left_after_some_were_set_aside_are_not_remembered() -> None:
    """One by one, gross errors would else keep as many copies of all that is known of the rows as there are of them."""
    rows = _rows(np.random.default_rng(12))
    left = rows.without(np.array([3])).without(np.array([7]))
    assert left.predictors
    gone = weakref.ref(left)
    del left
    assert gone() is None


def test_a_row_that_nothing_predicts_is_never_suspicious() -> None:
    rows = Rows(np.zeros(1, int), np.zeros(1, int), np.zeros(1, int), np.eye(3)[None] * 1e-10, np.zeros((1, 3, 0)))
    squared, error, _ = deleted(rows, np.ones((1, 3)))
    assert squared[0] == 0.0
    assert not error.any()
