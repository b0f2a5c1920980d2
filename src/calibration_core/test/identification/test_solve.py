"""Non-negative solutions, covariance and what cannot be determined."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from calibration_core.identification.result.observability import stiffness_table, weak_directions
from calibration_core.identification.statistics import solve_non_negative


def _normal(columns: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return columns.T @ columns, columns.T @ target


def test_inside_the_bounds_it_is_plain_least_squares() -> None:
    rng = np.random.default_rng(1)
    scales = np.array([1e-3, 1.0, 1e4])
    columns = rng.normal(size=(40, 3)) * scales
    truth = np.array([2.0, 1.0, 3e-4])
    solution = solve_non_negative(*_normal(columns, columns @ truth), np.zeros(3))
    np.testing.assert_allclose(solution.value, truth, rtol=1e-9)
    np.testing.assert_allclose(solution.covariance, np.linalg.inv(columns.T @ columns), rtol=1e-8)
    assert solution.determined.all()
    assert not solution.at_bound.any()
    unit = columns / np.linalg.norm(columns, axis=0)
    np.testing.assert_allclose(solution.condition_number, np.linalg.cond(unit), rtol=1e-9)


def test_at_the_bound_it_equals_the_bounded_least_squares_of_scipy() -> None:
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(30, 4))
    target = columns @ np.array([1.0, -0.5, 0.2, -2.0]) + rng.normal(0, 0.1, 30)
    solution = solve_non_negative(*_normal(columns, target), np.zeros(4))
    expected = lsq_linear(columns, target, bounds=(0, np.inf), tol=1e-14).x
    np.testing.assert_allclose(solution.value, expected, atol=1e-6)
    assert list(solution.at_bound) == [False, True, False, True]
    assert solution.unbounded[3] < 0


def test_an_unloaded_joint_keeps_its_value_and_is_called_unidentifiable() -> None:
    rng = np.random.default_rng(3)
    columns = np.column_stack([rng.normal(size=(30, 2)), np.zeros(30)])
    solution = solve_non_negative(*_normal(columns, columns @ np.array([1.0, 2.0, 0.0])), np.array([0.0, 0.0, 7.0]))
    np.testing.assert_allclose(solution.value, [1.0, 2.0, 7.0])
    assert list(solution.determined) == [True, True, False]
    table = stiffness_table(("a", "b", "c"), solution, 1e-3, None, np.array([5.0, 5.0, 0.0]))
    assert [joint.identifiable for joint in table] == [True, True, False]
    assert table[2].interval == (0.0, np.inf)
    assert "not identifiable" in table[2].reason
    (lost,) = weak_directions(("a", "b", "c"), solution)
    assert lost.combination == {"c": 1.0}


def test_two_joints_that_move_alike_are_named_together() -> None:
    rng = np.random.default_rng(4)
    shared = rng.normal(size=30)
    columns = np.column_stack([rng.normal(size=30), shared, 2 * shared])
    solution = solve_non_negative(*_normal(columns, columns @ np.array([1.0, 1.0, 1.0])), np.full(3, 0.5))
    assert list(solution.determined) == [True, False, False]
    (lost,) = weak_directions(("a", "b", "c"), solution)
    assert set(lost.combination) == {"b", "c"}


def test_intervals_are_reciprocal_and_finite_where_a_joint_may_be_rigid() -> None:
    columns = np.eye(2)
    solution = solve_non_negative(*_normal(columns, np.array([1e-6, 1e-7])), np.zeros(2))
    first, second = stiffness_table(("a", "b"), solution, 1e-7, None, np.ones(2))
    np.testing.assert_allclose(first.interval, (1 / (1e-6 + 1.959964e-7), 1 / (1e-6 - 1.959964e-7)), rtol=1e-6)
    np.testing.assert_allclose((first.value, first.std), (1e6, 1e5), rtol=1e-9)
    assert first.identifiable
    assert 1e7 < second.interval[1] < 1e9  # 1 sigma from zero: the normal distribution above zero
    np.testing.assert_allclose(second.compliance_std / second.compliance, 1.0, rtol=1e-9)
    assert second.reason == (
        "hardly identifiable: the standard deviation of its compliance exceeds a third of it (load 1 N·m rms)"
    )


def test_loads_of_sliding_joints_are_forces_and_large_ones_are_written_in_full() -> None:
    solution = solve_non_negative(*_normal(np.eye(2), np.array([1e-6, 1e-7])), np.zeros(2))
    _, second = stiffness_table(("a", "b"), solution, 1e-7, None, np.array([1.0, 1234.0]), (False, True))
    assert second.reason.endswith("(load 1,230 N rms)")
