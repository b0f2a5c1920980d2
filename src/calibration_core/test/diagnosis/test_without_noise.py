"""A simulation without noise leaves rounding errors, which are neither physics nor gross errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from several_cases import measured, setup

from calibration_core.cell import load_cell
from calibration_core.cli import main
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.model.parameters import AppliedEffect
from calibration_core.observations.observe import observe

CELL = Path(__file__).resolve().parents[4] / "config" / "cells" / "small.cell.yaml"

TILT = AppliedEffect(
    "off_axis_compliance",
    {"joint": "joint_2"},
    "before",
    {"compliance_x": 2e-7, "compliance_y": 1e-7, "compliance_xy": 1e-8},
)
KINDS: dict[str, dict[str, Any]] = {
    "loaded": {},
    "at rest": {"configurations": 0, "rest": 40},
    "both": {"configurations": 10, "rest": 30},
}


@pytest.mark.parametrize(
    ("kind", "effects"),
    [
        ("loaded", ()),
        ("at rest", ()),
        ("both", (TILT,)),
        pytest.param("loaded", (TILT,), marks=pytest.mark.slow),
        pytest.param("at rest", (TILT,), marks=pytest.mark.slow),
        pytest.param("both", (), marks=pytest.mark.slow),
    ],
)
def test_nothing_but_what_is_there_is_found(tmp_path: Path, kind: str, effects: tuple[Any, ...]) -> None:
    """The points of a loaded recording stand a millimetre elsewhere than the cell file says: no physics is missing."""
    cell = setup(tmp_path, 0)
    found = diagnose(measured(cell, 0, 7, effects=effects, noise=0.0, **KINDS[kind]), cell)
    named = [(one.effect, dict(one.location)) for one in found.findings]
    assert named == [(one.effect, dict(one.location)) for one in effects]
    assert [one.kind for one in found.anomalies if one.kind != "noise_overstated"] == []
    assert not found.rest.significant
    assert found.verdict == ("missing_physics" if found.findings else "consistent")


def test_a_simulated_bag_without_noise_has_come_to_rest(tmp_path: Path) -> None:
    """Averaged samples of a bag differ from its table by rounding; no configuration swings because of that."""
    assert main(["simulate", "--cell", str(CELL), "--out", str(tmp_path), "--no-report", "--quiet"]) == 0
    cell = load_cell(CELL)
    found = diagnose(observe(tmp_path / "recording", cell), cell)
    assert found.anomalies == ()
    assert found.verdict == "consistent"
