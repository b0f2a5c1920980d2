"""Rotations by a vector equal those of an independent library, tiny and large ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration_core.model.chain import rotation_about


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-5, 0.3, 3.0, np.pi, 7.0])
def test_rotation_about(size: float) -> None:
    vector = size * np.array([2.0, -1.0, 2.0]) / 3.0
    np.testing.assert_allclose(rotation_about(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)
