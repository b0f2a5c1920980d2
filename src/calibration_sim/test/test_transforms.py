"""Rotations and placements: laws, and scipy as a witness."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration_core.cell import Pose
from calibration_sim.mechanics.transforms import fixed_axes, placement, quaternion, rotation_vector

SEEDS = range(20)


@pytest.mark.parametrize("seed", SEEDS)
def test_fixed_axes_and_rotation_vectors(seed: int) -> None:
    angles = np.random.default_rng(seed).uniform(-3, 3, 3)
    assert fixed_axes(*angles) == pytest.approx(Rotation.from_euler("xyz", angles).as_matrix(), abs=1e-14)
    assert rotation_vector(angles) == pytest.approx(Rotation.from_rotvec(angles).as_matrix(), abs=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_quaternion_turns_as_the_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vector = rng.standard_normal(3)
    vector *= rng.choice([0.0, 1e-9, 1.0, np.pi, np.pi - 1e-7]) / np.linalg.norm(vector)
    rotation = rotation_vector(vector)
    w, x, y, z = quaternion(rotation)
    assert Rotation.from_quat([x, y, z, w]).as_matrix() == pytest.approx(rotation, abs=1e-14)


def test_placements_chain_and_invert() -> None:
    first = placement(Pose(xyz=(0.1, 0.2, 0.3), rpy=(0.4, -0.5, 0.6)))
    second = placement(Pose(xyz=(-1.0, 2.0, 0.5), rpy=(2.0, 0.1, -1.0)))
    points = np.random.default_rng(0).standard_normal((4, 5, 3))
    assert (first @ second).apply(points) == pytest.approx(first.apply(second.apply(points)), abs=1e-14)
    assert first.inverse_apply(first.apply(points)) == pytest.approx(points, abs=1e-14)
