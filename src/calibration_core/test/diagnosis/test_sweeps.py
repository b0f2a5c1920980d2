"""Slow circles of single joints, measured for the geometry, also tell what a joint's transmission does wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
from absolute_cases import make_cell, make_readings, random_angles, truth_of

from calibration_core.cell import Cell
from calibration_core.diagnosis.positions import diagnose_still
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.timeseries import Readings

WAVES = {2: (1.5e-4, 0.5), 7: (1.0e-4, -1.0)}  # cycles per revolution of joint 2: amplitude and phase, rad
HOME = np.array([0.2, -0.4, 0.3, 0.4, 0.9, -0.3])
POSES, ARC = 30, 2.9


def _sweeps(others: int) -> np.ndarray:
    """Return a sweep of every joint and other postures beside them, (m, 6) rad."""
    parts = []
    for joint in range(6):
        q = np.tile(HOME, (POSES, 1))
        q[:, joint] += np.linspace(-ARC / 2, ARC / 2, POSES)
        parts.append(q)
    return np.concatenate([*parts, random_angles(3, others, 6)])


def _waves(q: np.ndarray) -> np.ndarray:
    extra = np.zeros_like(q)
    extra[:, 1] = sum(size * np.sin(k * q[:, 1] + phase) for k, (size, phase) in WAVES.items())
    return extra


def _seen(cell: Cell, q: np.ndarray, extra: np.ndarray) -> Readings:
    """Return readings whose joints stand `extra` rad from where the encoders say."""
    return dataclasses.replace(make_readings(cell, truth_of(cell, 5), q + extra, seed=5), q=q)


def _named(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    return [(f.effect, str(*f.location.values())) for f in diagnosis.findings]


def test_a_transmission_error_in_slow_circles_is_named_with_its_joint_and_orders() -> None:
    cell = make_cell(points=("mp1",))
    q = _sweeps(40)
    found = diagnose_still(_seen(cell, q, _waves(q)), cell)
    assert _named(found)[0] == ("transmission_error", "joint_2")
    values = {p.name: p.value for p in found.findings[0].parameters}
    seen = {int(values[f"harmonic_{k}"]): values[f"amplitude_{k}"] for k in (1, 2) if f"harmonic_{k}" in values}
    assert abs(seen[7] - WAVES[7][0]) < 0.3 * WAVES[7][0]
    assert {effect for effect, _ in _named(found)} == {"transmission_error"}


def test_circles_almost_alone_tell_the_joint_and_its_orders() -> None:
    cell = make_cell(points=("mp1",))
    q = _sweeps(12)
    found = diagnose_still(_seen(cell, q, _waves(q)), cell)
    assert found.verdict == "missing_physics"
    assert _named(found) == [("transmission_error", "joint_2")]
    values = {p.name: p.value for p in found.findings[0].parameters}
    assert {values["harmonic_1"], values["harmonic_2"]} == set(WAVES)


def test_nothing_is_found_in_circles_of_a_sound_robot() -> None:
    cell = make_cell(points=("mp1",))
    q = _sweeps(40)
    found = diagnose_still(_seen(cell, q, np.zeros_like(q)), cell)
    assert _named(found) == []
    assert found.verdict == "consistent"
