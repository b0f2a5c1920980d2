"""Equilibrium on the deformed geometry: residual, derivatives, and what it says when there is none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.errors import EquilibriumError
from calibration_core.model.chain import Chain, rotation_rpy
from calibration_core.model.effects.state import wrench_response
from calibration_core.model.equilibrium import joint_torque, solve_equilibrium
from calibration_core.model.kinematics import posture
from calibration_core.model.statics import (
    Load,
    gravity_torque,
    gravity_torque_derivative,
    load_torque,
    load_torque_derivative,
)

M = 6
POINT = np.array([0.1, -0.2, 0.3])


def _load(sensor: bool) -> Load:
    rng = np.random.default_rng(5)
    rotation = rotation_rpy(0.3, -0.4, 1.1) if sensor else None
    return Load(rng.normal(0, 1000, (3, M)), rng.normal(0, 300, (3, M)), np.array([0.0, 0.1, 0.2]), rotation)


def _angles(chain: Chain) -> np.ndarray:
    return np.random.default_rng(6).uniform(-2, 2, (M, chain.n))


def _central(function, q: np.ndarray, step: float = 1e-6) -> np.ndarray:
    columns = []
    for j in range(q.shape[1]):
        h = np.zeros(q.shape[1])
        h[j] = step
        columns.append((function(q + h) - function(q - h)) / (2 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("sensor", [True, False], ids=["sensor axes", "base axes"])
def test_load_torque_derivative(chain: Chain, sensor: bool) -> None:
    q, load = _angles(chain), _load(sensor)
    numeric = _central(lambda x: load_torque(posture(chain, x), load), q)
    np.testing.assert_allclose(load_torque_derivative(posture(chain, q), load), numeric, atol=2e-5)


def test_gravity_torque_derivative(chain: Chain) -> None:
    q = _angles(chain)
    numeric = _central(lambda x: gravity_torque(chain, posture(chain, x)), q)
    np.testing.assert_allclose(gravity_torque_derivative(chain, posture(chain, q)), numeric, atol=2e-5)


@pytest.mark.parametrize("sensor", [True, False], ids=["sensor axes", "base axes"])
def test_equilibrium_and_its_derivative_by_compliance(chain: Chain, sensor: bool) -> None:
    q, load = _angles(chain), _load(sensor)
    compliance = np.random.default_rng(9).uniform(2e-7, 3e-6, chain.n)
    rest = solve_equilibrium(chain, q, compliance, load)
    torque = joint_torque(chain, posture(chain, q + rest.deflection.T), load)
    np.testing.assert_allclose(rest.deflection, compliance[:, None] * torque, atol=1e-12)

    def moved(c: np.ndarray) -> np.ndarray:
        return solve_equilibrium(chain, q, c, load).at.point(POINT)

    exact = rest.loaded_point_jacobian(POINT) * rest.torque
    for j in range(chain.n):
        h = np.zeros(chain.n)
        h[j] = 1e-9
        numeric = (moved(compliance + h) - moved(compliance - h)) / 2e-9
        np.testing.assert_allclose(exact[:, j], numeric, rtol=2e-5, atol=1e-3 * np.abs(exact).max())
        np.testing.assert_allclose(exact[:, j], numeric, atol=2e-6 * np.abs(exact).max())


@pytest.mark.parametrize("sensor", [True, False], ids=["sensor axes", "base axes"])
def test_the_derivative_by_the_wrench(chain: Chain, sensor: bool) -> None:
    q, load = _angles(chain), _load(sensor)
    compliance = np.random.default_rng(9).uniform(2e-7, 3e-6, chain.n)
    rest = solve_equilibrium(chain, q, compliance, load)
    exact = wrench_response(rest.loaded_point_jacobian(POINT) * compliance[:, None], rest.at, load)
    for k in range(6):
        name, step = ("force", "torque")[k // 3], np.eye(3)[k % 3][:, None]
        more, less = (dataclasses.replace(load, **{name: getattr(load, name) + sign * step}) for sign in (1, -1))
        ends = (solve_equilibrium(chain, q, compliance, one).at.point(POINT) for one in (more, less))
        numeric = (next(ends) - next(ends)) / 2
        np.testing.assert_allclose(exact[:, :, k].T, numeric, atol=1e-6 * np.abs(exact).max())


def test_small_loads_give_the_linear_law_of_the_standard(chain: Chain) -> None:
    q = _angles(chain)
    load = Load(np.full((3, M), 1e-3), np.zeros((3, M)), POINT, None)
    compliance = np.full(chain.n, 1e-6)
    light = Chain(**{**{f: getattr(chain, f) for f in chain.__dataclass_fields__}, "mass": None, "com": None})
    rest = solve_equilibrium(light, q, compliance, load)
    expected = compliance[:, None] * load_torque(posture(light, q), load)
    np.testing.assert_allclose(rest.deflection, expected, rtol=1e-6, atol=1e-16)


def test_a_load_beyond_the_springs_is_an_error(chain: Chain) -> None:
    with pytest.raises(EquilibriumError, match="no static equilibrium"):
        solve_equilibrium(chain, _angles(chain), np.full(chain.n, 1e-2), _load(sensor=False))


@pytest.mark.parametrize("given", ["sensor axes", "base axes", "no load"])
def test_points_of_one_step_share_its_equilibrium(chain: Chain, given: str) -> None:
    load, some = None if given == "no load" else _load(given == "sensor axes"), np.repeat(np.arange(M), 3)
    compliance = np.random.default_rng(9).uniform(2e-7, 3e-6, chain.n)
    each = solve_equilibrium(chain, _angles(chain), compliance, load)
    shared = solve_equilibrium(chain, _angles(chain)[some], compliance, None if load is None else load.rows(some))
    for part in ("deflection", "torque", "amplification"):
        np.testing.assert_array_equal(getattr(shared, part), getattr(each, part)[..., some])
    for part in ("before", "origin", "body", "body_origin", "flange", "flange_origin"):
        np.testing.assert_array_equal(getattr(shared.at, part), getattr(each.at, part)[..., some])
    near = solve_equilibrium(
        chain, _angles(chain)[some], compliance, None if load is None else load.rows(some), each.torque[:, some]
    )
    np.testing.assert_allclose(near.torque, shared.torque, rtol=1e-12, atol=1e-9)


def test_one_load_or_one_angle_that_differs_is_a_reading_of_its_own(chain: Chain) -> None:
    q, compliance = np.repeat(_angles(chain)[:1], 3, axis=0), np.full(chain.n, 1e-6)
    q[1, -1] += 1e-3
    force = np.repeat(np.array([[0.0], [10.0], [-500.0]]), 3, axis=1)
    force[2, 2] = -400.0
    load = Load(force, np.zeros((3, 3)), np.zeros(3), None)
    torque = solve_equilibrium(chain, q, compliance, load).torque
    for k in range(3):
        alone = solve_equilibrium(chain, q[k : k + 1], compliance, load.rows(slice(k, k + 1))).torque
        np.testing.assert_allclose(torque[:, k : k + 1], alone, rtol=1e-12, atol=1e-9)
