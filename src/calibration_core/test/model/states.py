"""A robot of the 240 kg class and its states, at rest or under load, for the tests of effects."""

from __future__ import annotations

from typing import Any

import numpy as np

from calibration_core.model.chain import Chain, rotation_x
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.statics import Load
from calibration_core.timeseries import Float1D, Float2D

TIP = np.array([0.15, 0.05, 0.3])
COMPLIANCE = 1 / np.array([1.4e6, 4.0e6, 9.4e5, 3.6e5, 3.7e5, 3.8e5])
ROWS = ((0.35, -np.pi / 2, 0.75), (1.25, 0.0, 0.0), (0.041, -np.pi / 2, 0.0),
        (0.0, np.pi / 2, 1.1), (0.0, -np.pi / 2, 0.0), (0.0, 0.0, 0.23))  # fmt: skip


def an_arm(gravity: tuple[float, float, float] = (0.0, 0.0, -9.81), **masses: np.ndarray) -> Chain:
    """Return a robot of six joints; `mass` and `com` as for a chain."""
    rotation, translation = np.empty((6, 3, 3)), np.empty((6, 3))
    turned, moved = np.eye(3), np.zeros(3)
    for i, (a, alpha, d) in enumerate(ROWS):
        rotation[i], translation[i] = turned, moved
        turned, moved = rotation_x(alpha), np.array([a, 0.0, d])
    return Chain(
        joints=tuple(f"joint_{i + 1}" for i in range(6)), rotation=rotation, translation=translation,
        offset=np.zeros(6), flange_rotation=turned, flange_translation=moved, limits=np.tile([-3.0, 3.0], (6, 1)),
        gravity=np.array(gravity), **masses,
    )  # fmt: skip


def state_at(
    chain: Chain, q: Float2D, compliance: float | Float1D, load: Load | None = None, point: Float1D = TIP, **given: Any
) -> State:
    """Return the state of single steps at 20 degrees, a minute apart, of one point; what is given is different."""
    m = len(q)
    known = {
        "point_index": np.zeros(m, dtype=np.int64), "wrench": None, "configuration": np.arange(m),
        "step": np.zeros(m, dtype=np.int64), "time": np.arange(m) * 60.0, "temperature": np.full(m, 20.0),
        "tracker": np.eye(4), "rated_load": 240.0,
    }  # fmt: skip
    soft = np.broadcast_to(compliance, chain.n).astype(np.float64)
    return state_of(chain, q, soft, load, np.tile(point[:, None], (1, m)), **{**known, **given})
