"""Corrections of the geometry from postures at rest are as uncertain as the compliances by which the robot sags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from several_cases import measured, setup

from calibration_core.identification.absolute.evaluate import evaluate_absolute
from calibration_core.identification.identify import fit_freed
from calibration_core.identification.several.mixed import identify_mixed
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import value_of
from calibration_core.observations.kinds import standing

CORRECTED = Options(corrected=True)
SEEDS = range(3000, 3010)


def rows(estimate: GaussianEstimate, group: str) -> list[int]:
    return [k for k, name in enumerate(estimate.names) if name.startswith(group)]


def test_the_geometry_follows_the_compliances_as_finite_differences_say(tmp_path: Path) -> None:
    cell = setup(tmp_path, 0)
    readings = measured(cell, 0, 7, configurations=4, rest=14)
    found = identify_mixed(readings, cell, CORRECTED)
    estimate = found.estimate
    geometry, compliances = rows(estimate, "geometry."), rows(estimate, "compliance.")
    shared = estimate.covariance[np.ix_(geometry, compliances)]
    sensitivity = shared @ np.linalg.inv(estimate.covariance[np.ix_(compliances, compliances)])
    names = [estimate.names[k] for k in geometry]
    some = readings.select(standing(readings))

    def fitted(compliance: np.ndarray) -> np.ndarray:
        start = found.model.replace(geometry=np.zeros((6, 6)), compliance=compliance)
        at = evaluate_absolute(some, cell, Options(robust=False, start=start, corrected=True))
        return np.array([value_of(at.staged.final.fit.parameters, name) for name in names])

    for j in range(6):
        step = np.zeros(6)
        step[j] = 0.02 * found.model.compliance[j]
        slope = (fitted(found.model.compliance + step) - fitted(found.model.compliance - step)) / (2 * step[j])
        scale = np.abs(slope).max()
        np.testing.assert_allclose(sensitivity[:, j], slope, atol=0.02 * scale + 1e-3 * np.abs(sensitivity).max())


def test_intervals_of_the_geometry_cover_the_truth_where_few_loads_show_the_compliances(tmp_path: Path) -> None:
    cell, deviations = setup(tmp_path, 2), []
    for seed in SEEDS:
        found = fit_freed(measured(cell, 2, seed, configurations=4, rest=14), cell, CORRECTED, None).estimate
        some = rows(found, "geometry.")
        assert some
        deviations.append(found.value[some] / found.std[some])
        assert np.linalg.eigvalsh(found.covariance / np.outer(found.std, found.std)).min() > -1e-9
    every = np.concatenate(deviations)
    assert 0.85 < every.std() < 1.15  # 1.3 where the compliances are taken for sure
    assert np.mean(np.abs(every) < 1.96) > 0.92
