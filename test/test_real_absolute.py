"""Real recordings of single steps, measured by others: the figures that the project promises.

The data lies outside the repository (`../shared/data/real` from the project's root).
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.identification.identify import identify
from calibration_core.identification.result.estimate import Identification
from calibration_core.recording.tables.table import read_table

REAL = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"
UR10_BARS = {"A": 0.45e-3, "B": 0.46e-3, "C": 0.50e-3, "D": 0.41e-3}  # m, 3-d rms, cross-validated by configuration
SECONDS = 5.0

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")


def _identify(cell_name: str, recording: str, test: str | None = None) -> Identification:
    cell = load_cell(REAL / f"{cell_name}.cell.yaml")
    other = None if test is None else read_table(REAL / f"{test}.csv", cell)
    return identify(read_table(REAL / f"{recording}.csv", cell), cell, test=other)


def _stage(result: Identification, name: str):
    return next(stage for stage in result.stages if stage.name == name)


def _held_out_3d(result: Identification) -> float:
    """Return the 3-d rms over all readings, excluded ones included."""
    return float(np.sqrt(np.mean(np.sum(result.residuals.held_out**2, axis=1))))


def test_ur5() -> None:
    result = _identify("ur5", "ur5_grid", "ur5_random")
    assert result.test is not None
    assert result.test.mean_before == pytest.approx(2.565e-3, abs=5e-6)
    assert result.test.mean <= 0.105e-3
    assert not _stage(result, "elasticity").kept
    assert result.stiffness == ()
    assert "harmonic of the transmission" in _stage(result, "elasticity").reason
    assert not result.exclusions
    assert not result.noise.understated
    assert "depends on posture" in result.noise.text


@pytest.mark.slow
def test_wam_with_seven_joints() -> None:
    result = _identify("wam", "wam_grid", "wam_random")
    assert len(result.model.joints) == 7
    assert result.test is not None
    assert _stage(result, "geometry").kept
    assert result.test.mean <= 3.10e-3
    assert not _stage(result, "elasticity").kept
    assert "does not collapse" in _stage(result, "elasticity").reason
    assert result.condition_number < 100


@pytest.mark.parametrize(
    "series", [pytest.param(one, marks=[] if one == "D" else [pytest.mark.slow]) for one in UR10_BARS]
)
def test_ur10(series: str) -> None:
    start = time.process_time()  # one thread, so the wall clock of a quiet machine; other work does not count
    result = _identify(f"ur10_{series}", f"ur10_{series}")
    seconds = time.process_time() - start
    assert _held_out_3d(result) <= UR10_BARS[series]
    assert _stage(result, "geometry").kept
    assert _stage(result, "geometry").held_out_rms <= UR10_BARS[series]
    assert seconds <= SECONDS
    named = [(exclusion.configuration, exclusion.point) for exclusion in result.exclusions]
    assert named == ([(533, "mp1"), (855, "mp1"), (856, "mp1")] if series == "B" else [])
    for entry in result.stiffness:  # where a claim is made, it is of the size of such a robot's joints
        assert not entry.identifiable or 2e4 < entry.value < 1e6
    if series == "D":  # whose flange keeps its direction
        assert [u for u in result.unidentified if "mp1 z" in u.combination and "tracker y" in u.combination]
        point = next(entry for entry in result.parameters if entry.name == "mp1 z")
        assert not point.fitted
        assert point.value == point.nominal
