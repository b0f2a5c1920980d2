"""A FANUC R-2000iC under 43 cable loads, measured by others (data/real beside the project)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.observations.observe import observe
from calibration_core.timeseries import Readings

REAL = Path(__file__).parents[2] / "shared/data/real"
PUBLISHED = np.array([0.861e6, 2.72e6, 1.96e6, 0.271e6, 0.425e6, 0.206e6])  # plain least squares on the same 43 pairs
RELATIVE_STD = np.array([0.035, 0.16, 0.12, 0.14, 0.17, 0.48])
LEAVE_ONE_OUT = 0.331e-3

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")


@pytest.fixture(scope="module")
def fanuc() -> tuple[Readings, Cell]:
    cell = load_cell(REAL / "fanuc.cell.yaml")
    return observe(REAL / "fanuc.csv", cell), cell


@pytest.mark.parametrize("method", ["linear", "equilibrium"])
def test_plain_weights_repeat_the_known_figures(fanuc: tuple[Readings, Cell], method: str) -> None:
    found = identify(*fanuc, Options(method=method, weights="plain", robust=False))
    values = np.array([joint.value for joint in found.stiffness])
    stds = np.array([joint.std / joint.value for joint in found.stiffness])
    np.testing.assert_allclose(values, PUBLISHED, rtol=0.01)
    np.testing.assert_allclose(stds, RELATIVE_STD, rtol=0.1)
    assert found.fit.held_out_mean_after <= LEAVE_ONE_OUT
    assert [joint.identifiable for joint in found.stiffness] == [True] * 5 + [False]
    assert "hardly identifiable" in found.stiffness[5].reason
    assert found.noise.understated


def test_the_robust_default_predicts_no_worse(fanuc: tuple[Readings, Cell]) -> None:
    found = identify(*fanuc)
    plain = identify(*fanuc, Options(method="linear", weights="plain", robust=False))
    assert found.fit.held_out_mean_after <= plain.fit.held_out_mean_after
    assert all(exclusion.reason for exclusion in found.exclusions)
    assert "noise_understated" in [anomaly.kind for anomaly in found.anomalies]
