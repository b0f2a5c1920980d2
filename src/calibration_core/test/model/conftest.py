"""Robots that the model tests run on."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.model.chain import Chain, rotation_rpy


def random_chain(seed: int, n: int, sliding: tuple[int, ...] = ()) -> Chain:
    """Return a chain of n joints, some of them sliding, with arbitrary placements, offsets, masses and flange."""
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
        prismatic=tuple(i in sliding for i in range(n)),
    )


@pytest.fixture(
    params=[(1, 3), (2, 6), (3, 7), (4, 7, (0,)), (5, 5, (1, 3))],
    ids=["3 joints", "6 joints", "7 joints", "6 joints on a rail", "5 joints, two of them sliding"],
)
def chain(request: pytest.FixtureRequest) -> Chain:
    """Return chains of three to seven joints, some on a linear unit."""
    return random_chain(*request.param)
