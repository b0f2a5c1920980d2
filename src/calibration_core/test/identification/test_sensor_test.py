"""The test of a force/torque sensor recovers what was wrong with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from calibration_core.cell import load_cell
from calibration_core.errors import CellError, IdentificationError
from calibration_core.identification.checks.sensor_test import evaluate_sensor_test, gravity_in_sensor
from calibration_core.model.robot import chain_of, pinocchio_model

CELL = Path(__file__).resolve().parents[4] / "config" / "cells" / "demo.cell.yaml"
G = 9.80665
BIAS = np.array([12.0, -7.0, 30.0, 1.0, -2.0, 0.5])
LEVER = np.array([0.01, -0.02, 0.15])


def readings(
    n: int, sign: int = 1, mass: float = 25.0, turn: float = 0.0, noise: float = 0.1
) -> tuple[np.ndarray, np.ndarray]:
    """What a sensor reads that is turned about its z axis by `turn`, and gravity in its declared axes."""
    rng = np.random.default_rng(n)
    weights = -G * Rotation.random(n, random_state=n).as_matrix()[:, 2]
    force = sign * mass * weights @ Rotation.from_euler("z", turn).as_matrix().T
    wrench = np.hstack([force, np.cross(LEVER, force)]) + BIAS
    return wrench + noise * rng.standard_normal((n, 6)) * np.array([1, 1, 1, 0.1, 0.1, 0.1]), weights


@pytest.mark.parametrize("n", [3, 4, 12])
@pytest.mark.parametrize("sign", [1, -1])
def test_sign_mass_bias_and_lever(n: int, sign: int) -> None:
    wrench, weights = readings(n, sign, noise=1e-6)
    found = evaluate_sensor_test(wrench, weights)
    assert found.sign == sign
    assert found.mass == pytest.approx(25.0, rel=1e-6)
    np.testing.assert_allclose(found.bias, BIAS, atol=1e-4)
    np.testing.assert_allclose(found.centre_of_mass, LEVER, atol=1e-6)
    assert found.frame_error < 1e-4
    assert ("the sign is reversed" in " ".join(found.faults(25.0))) is (sign < 0)


def test_a_sound_sensor_has_no_faults_within_its_noise() -> None:
    found = evaluate_sensor_test(*readings(8))
    assert found.faults(25.0) == []
    assert found.residual_force == pytest.approx(0.08, abs=0.05)


@pytest.mark.parametrize(("change", "words"), [({"turn": 0.5}, "axes are off by 28."), ({"mass": 20.0}, "weighs 20.0")])
def test_faults_are_named(change: dict[str, float], words: str) -> None:
    faults = evaluate_sensor_test(*readings(8, **change)).faults(25.0)
    assert len(faults) == 1
    assert words in faults[0]


def test_a_rest_that_nothing_explains_is_a_fault() -> None:
    faults = evaluate_sensor_test(*readings(12, noise=20.0)).faults(25.0, mass_share=0.5, angle=1.0)
    assert len(faults) == 1
    assert "the fit leaves" in faults[0]


def test_too_few_or_too_similar_orientations() -> None:
    wrench, weights = readings(8)
    with pytest.raises(IdentificationError, match="found 2 orientations, expected at least 3"):
        evaluate_sensor_test(wrench[:2], weights[:2])
    alike = np.array([0.0, 0.0, -G]) + 0.05 * np.random.default_rng(3).standard_normal((8, 3))
    with pytest.raises(IdentificationError, match="nearly the same direction"):
        evaluate_sensor_test(wrench, alike)


def test_gravity_in_the_sensor() -> None:
    cell = load_cell(CELL)
    model = pinocchio_model(chain_of(cell))
    data = model.createData()
    mounted = cell.frames.force_torque
    assert mounted is not None
    for q in np.random.default_rng(4).uniform(-2, 2, (5, model.nq)):
        pinocchio.framesForwardKinematics(model, data, q)
        flange = data.oMf[model.getFrameId("flange")].rotation
        expected = (flange @ pinocchio.rpy.rpyToMatrix(np.array(mounted.rpy))).T @ cell.gravity
        np.testing.assert_allclose(gravity_in_sensor(cell, q), expected, atol=1e-12)
    without = cell.model_copy(update={"frames": cell.frames.model_copy(update={"force_torque": None})})
    with pytest.raises(CellError, match="force_torque"):
        gravity_in_sensor(without, np.zeros(model.nq))
