"""Three points give the frame of the end effector, with its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.identification.standard.kinematic_phases import frame_of
from calibration_core.model.chain import rotation_vector

POINTS = np.array([[0.17, 0.0, 0.12], [-0.09, 0.15, 0.12], [-0.09, -0.15, 0.18]])


def test_axes_follow_their_definition() -> None:
    pose = frame_of(POINTS, np.zeros((9, 9))).pose
    local = (POINTS - pose[:3, 3]) @ pose[:3, :3]
    np.testing.assert_allclose(local[0], 0, atol=1e-15)
    np.testing.assert_allclose(local[1, 1:], 0, atol=1e-15)
    assert local[1, 0] > 0
    assert local[2, 1] > 0
    assert local[2, 2] == pytest.approx(0, abs=1e-15)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


def test_intervals_cover() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(0, 1e-5, (9, 9))
    true = frame_of(POINTS, root @ root.T)
    errors = []
    for _ in range(400):
        found = frame_of(POINTS + (root @ rng.standard_normal(9)).reshape(3, 3), root @ root.T)
        turn = rotation_vector(found.pose[:3, :3] @ true.pose[:3, :3].T)
        errors.append(np.concatenate([found.pose[:3, 3] - true.pose[:3, 3], turn]) / found.std)
    assert np.all(np.abs(np.mean(np.abs(errors) <= 1.96, axis=0) - 0.95) < 0.04)


def test_points_on_one_line_are_refused() -> None:
    with pytest.raises(ValueError, match="on one line"):
        frame_of(np.outer([0.0, 1.0, 2.0], [0.1, 0.1, 0.1]), np.zeros((9, 9)))
