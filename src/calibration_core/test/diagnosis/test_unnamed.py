"""Intervals where many small effects are present that nothing names: joints, loaded and at rest, tilt a little."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS
from several_cases import measured, setup

from calibration_core.cell import Cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.identify import fit_freed
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.parameters import AppliedEffect

GEOMETRY = 4e-4 * np.random.default_rng(3).standard_normal((6, 6))
SOFTER = (1.0, 1.0, 1.0, 1.5, 2.0, 2.0)  # towards the hand
SEEDS = range(4)


def tilts(rng: np.random.Generator, size: float) -> tuple[AppliedEffect, ...]:
    """Return an off-axis compliance of every joint, rad/(N*m), of the stated size and any direction."""
    found = []
    for joint, softer in enumerate(SOFTER, start=1):
        half = rng.standard_normal((2, 2))
        matrix = half @ half.T
        matrix *= 2 * size * softer / np.trace(matrix)
        values = {"compliance_x": matrix[0, 0], "compliance_y": matrix[1, 1], "compliance_xy": matrix[0, 1]}
        found.append(AppliedEffect("off_axis_compliance", {"joint": f"joint_{joint}"}, "before", values))
    return tuple(found)


def off(cell: Cell, seed: int, size: float) -> tuple[Diagnosis, np.ndarray]:
    """Return what is found, and how far its compliances are from the truth, standard deviations."""
    effects = tilts(np.random.default_rng(seed), size)
    readings = measured(cell, 0, 500 + seed, configurations=12, rest=30, geometry=GEOMETRY, effects=effects)
    found = diagnose(readings, cell)
    assert found.compliance is not None
    assert found.compliance_covariance is not None
    return found, (found.compliance - 1 / np.array(STIFFNESS)) / np.sqrt(np.diag(found.compliance_covariance))


@pytest.mark.slow
def test_intervals_hold_the_stiffness_beside_small_effects(tmp_path: Path) -> None:
    """Most of the tilts are too small to be named; with the noise alone a third of the values were outside."""
    cell = setup(tmp_path, 0, sigma=2e-5)
    several = np.array([off(cell, seed, 5e-9)[1] for seed in SEEDS])
    assert np.mean(np.abs(several) < 1.96) >= 0.9
    assert np.abs(several).max() < 3.5


def test_without_small_effects_intervals_stay_narrow(tmp_path: Path) -> None:
    cell = setup(tmp_path, 0, sigma=2e-5)
    nothing, off_by = off(cell, 1, 0.0)
    assert nothing.findings == ()
    assert np.abs(off_by).max() < 3.0
    assert nothing.compliance_covariance is not None
    standard = fit_freed(nothing.identification.readings, cell, Options(), None)
    seen = np.sqrt(np.diag(nothing.compliance_covariance)) / [one.compliance_std for one in standard.stiffness]
    assert np.median(seen) < 1.5
