"""Robots that the model tests run on."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.model.chain import Chain, rotation_rpy


def random_chain(seed: int, n: int) -> Chain:
    """Return a chain of n joints with arbitrary placements, offsets, masses and flange."""
    rng = np.random.default_rng(seed)
    return Chain(
        joints=tuple(f"joint_{i + 1}" for i in range(n)),
        rotation=np.stack([rotation_rpy(*rng.uniform(-2, 2, 3)) for _ in range(n)]),
        translation=rng.uniform(-0.8, 0.8, (n, 3)),
        offset=rng.uniform(-1, 1, n),
        flange_rotation=rotation_rpy(*rng.uniform(-2, 2, 3)),
        flange_translation=rng.uniform(-0.3, 0.3, 3),
        limits=np.tile([-3.0, 3.0], (n, 1)),
        gravity=np.array([0.3, -0.2, -9.7]),
        mass=rng.uniform(5, 100, n),
        com=rng.uniform(-0.3, 0.3, (n, 3)),
    )


@pytest.fixture(params=[(1, 3), (2, 6), (3, 7)], ids=["3 joints", "6 joints", "7 joints"])
def chain(request: pytest.FixtureRequest) -> Chain:
    """Return chains of three, six and seven joints."""
    return random_chain(*request.param)
