"""Slow circles of single joints, measured for the geometry, also tell what a joint's transmission does wrong."""

from __future__ import annotations

import numpy as np
from absolute_cases import make_cell, random_angles
from test_absolute import WAVES, named, planted, waves

from calibration_core.diagnosis.absolute import diagnose_absolute

HOME = np.array([0.2, -0.4, 0.3, 0.4, 0.9, -0.3])
POSES, ARC = 30, 2.9


def _sweeps() -> np.ndarray:
    """Return a sweep of every joint and a few poses beside them, (m, 6) rad."""
    parts = []
    for joint in range(6):
        q = np.tile(HOME, (POSES, 1))
        q[:, joint] += np.linspace(-ARC / 2, ARC / 2, POSES)
        parts.append(q)
    return np.concatenate([*parts, random_angles(3, 12, 6)])


def test_a_transmission_error_in_slow_circles_is_named_with_its_joint_and_orders() -> None:
    cell = make_cell(points=("mp1",))
    q = _sweeps()
    found = diagnose_absolute(planted(cell, q, waves(q)), cell)
    assert named(found)[0] == ("transmission_error", "joint_2")
    values = {p.name: p.value for p in found.findings[0].parameters}
    seen = {int(values[f"harmonic_{k}"]): values[f"amplitude_{k}"] for k in (1, 2) if f"harmonic_{k}" in values}
    assert abs(seen[7] - WAVES[7][0]) < 0.3 * WAVES[7][0]
    assert {effect for effect, _ in named(found)} == {"transmission_error"}


def test_nothing_is_found_in_circles_of_a_sound_robot() -> None:
    cell = make_cell(points=("mp1",))
    q = _sweeps()
    found = diagnose_absolute(planted(cell, q, np.zeros_like(q)), cell)
    assert named(found) == []
    assert found.verdict == "consistent"
