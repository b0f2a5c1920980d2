"""How far an estimate is from what physics allows."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.model.effects.candidate import Parameter
from calibration_core.model.effects.possible import forbidden, nearest, out_of_bounds

COMPLIANCE, BETWEEN = Parameter("x", "rad/(N*m)", 1e-7, positive=True), Parameter("xy", "rad/(N*m)", 1e-7)
HINGE = (COMPLIANCE, COMPLIANCE, BETWEEN)
THREE_AXES = (*HINGE, COMPLIANCE, BETWEEN, BETWEEN)
PLACES = ((0, 0), (1, 1), (0, 1), (2, 2), (0, 2), (1, 2))  # of their parameters in a matrix
STD = 1e-7


def test_what_physics_allows_costs_nothing() -> None:
    assert nearest([HINGE], np.array([3e-7, 3e-7, 2e-7]), STD**2 * np.eye(3)).nats == 0.0
    assert nearest([(BETWEEN,)], np.array([-9e-7]), np.array([[STD**2]])).nats == 0.0


@pytest.mark.parametrize("deviations", [0.5, 2.0, 4.0])
def test_a_negative_compliance_costs_its_distance_from_zero(deviations: float) -> None:
    assert nearest([(COMPLIANCE,)], np.array([-deviations * STD]), np.array([[STD**2]])).nats == pytest.approx(
        deviations**2 / 2, rel=1e-6
    )


def test_a_correlated_neighbour_gives_way() -> None:
    """With both compliances known only in their sum, a negative one is paid by the other and costs little."""
    covariance = STD**2 * np.array([[1.0, -0.99], [-0.99, 1.0]])
    alone = nearest([(COMPLIANCE,)], np.array([-2e-7]), np.array([[STD**2]])).nats
    together = nearest([(COMPLIANCE, COMPLIANCE)], np.array([-2e-7, 6e-7]), covariance).nats
    assert together == pytest.approx(alone, rel=1e-3)  # the other follows by its correlation
    apart = nearest([(COMPLIANCE, COMPLIANCE)], np.array([-2e-7, 1e-7]), covariance).nats
    assert apart > 10 * alone  # both cannot be raised at once


@pytest.mark.parametrize("seed", range(20))
def test_a_bound_value_is_exactly_zero(seed: int) -> None:
    """Where the data tell hardly more than a sum, too: what rounding leaves is no compliance."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((6, 1)) + 10.0 ** rng.uniform(-6, -2) * rng.standard_normal((6, 6))
    mean = 3 * STD * rng.standard_normal(6)
    mean[0] = -STD
    found = nearest([(COMPLIANCE,)] * 6, mean, STD**2 * root @ root.T)
    held = found.held.any(axis=0)
    assert held.any()
    assert np.all((found.value == 0.0) == held)
    assert np.all(held | (found.value > 1e-9 * STD))


def test_a_hinge_that_twists_without_bending_costs() -> None:
    """On a fine grid of positive matrices none is nearer."""
    mean = np.array([0.5e-7, 0.2e-7, 4e-7])
    cost = nearest([HINGE], mean, STD**2 * np.eye(3)).nats
    side = np.linspace(0.0, 6e-7, 241)
    x, y = np.meshgrid(side, side)
    between = np.minimum(mean[2], np.sqrt(x * y))
    grid = ((x - mean[0]) ** 2 + (y - mean[1]) ** 2 + (between - mean[2]) ** 2).min() / (2 * STD**2)
    assert cost == pytest.approx(grid, rel=0.01)
    assert cost > 1.0


@pytest.mark.parametrize(("turned", "expected"), [(1.0, False), (2.4, False), (2.6, True), (-2.6, True)])
def test_a_parameter_reaches_as_far_as_its_law_is_linear(turned: float, expected: bool) -> None:
    """Twice the first parameter, and two standard deviations of both on top: 2 (1 + 0.1) + 0.3 = 2.5."""
    parameters = Parameter("torque", "N*m", 1.0), Parameter("torque_turned", "N*m", 1.0, reach=2.0)
    why = out_of_bounds(parameters, np.array([1.0, turned]), np.diag([0.05**2, 0.15**2]))
    assert ("another form" in why) is expected


@pytest.mark.parametrize(("value", "expected"), [(0.9, False), (1.19, False), (1.21, True), (-1.21, True)])
def test_a_parameter_is_no_larger_than_physics_allows(value: float, expected: bool) -> None:
    parameters = (Parameter("compliance", "rad/(N*m)", 1.0, most=1.0),)
    why = out_of_bounds(parameters, np.array([value]), np.array([[0.1**2]]))
    assert ("larger than physics allows" in why) is expected


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("hinge", [HINGE, THREE_AXES], ids=["two axes", "three axes"])
def test_the_nearest_values_are_positive_and_none_is_nearer(hinge: tuple[Parameter, ...], seed: int) -> None:
    """Projection on a convex set: seen from the nearest point, everything allowed lies away from the estimate."""
    rng = np.random.default_rng(seed)
    k, places = len(hinge), PLACES[: len(hinge)]
    root = rng.standard_normal((2 * k + 2, 2 * k + 4)) * STD
    covariance, mean = root @ root.T, rng.standard_normal(2 * k + 2) * 3e-7
    found = nearest((hinge, (COMPLIANCE,), hinge, (BETWEEN,)), mean, covariance)
    axes = 1 + max(map(max, places))
    for part in (found.value[:k], found.value[k + 1 : -1]):
        matrix = np.zeros((axes, axes))
        for (i, j), value in zip(places, part, strict=True):
            matrix[i, j] = matrix[j, i] = value
        assert np.linalg.eigvalsh(matrix)[0] >= -1e-12 * np.abs(matrix).max()
    assert found.nats > 0
    assert found.value[k] >= 0
    assert np.abs(found.held @ found.value).max() < 1e-6 * np.abs(found.value).max()
    away = np.linalg.solve(covariance, mean - found.value)
    sides = rng.standard_normal((500, 2, axes, axes))
    matrices = sides @ sides.transpose(0, 1, 3, 2)
    values = np.stack([matrices[:, :, i, j] for i, j in places], axis=2)
    others = np.abs(rng.standard_normal(500)), rng.standard_normal(500)
    allowed = np.column_stack([values[:, 0], others[0], values[:, 1], others[1]]) * 3e-7
    assert ((allowed - found.value) @ away).max() < 1e-4 * (1 + found.nats)


def test_values_that_nothing_forbids_stay_to_the_bit() -> None:
    mean = np.array([3e-7, 3e-7, 2e-7, 1e-7])
    found = nearest((HINGE, (COMPLIANCE,)), mean, STD**2 * np.eye(4))
    np.testing.assert_array_equal(found.value, mean)
    assert found.held.shape == (0, 4)


def test_scatter_below_zero_is_allowed_and_what_costs_a_share_of_the_gain_is_not() -> None:
    assert not forbidden(2.0, gain=3.0)
    assert forbidden(3.0, gain=3.0)
    assert not forbidden(19.0, gain=100.0)
    assert forbidden(21.0, gain=100.0)
