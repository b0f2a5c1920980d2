"""Real recordings of single steps, measured by others: what the geometric model leaves out there, and the proof.

The data lies outside the repository (`../shared/data/real` from the project's root).  All figures are on configurations
left out as whole blocks (ten contiguous in time, twenty clusters of postures), or on recordings that were not fitted.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.diagnosis.positions import diagnose_still
from calibration_core.diagnosis.result.finding import Diagnosis, Finding
from calibration_core.recording.tables.table import read_table

REAL = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"
UR10 = ("A", "B", "C", "D")
GEOMETRY = {"A": 0.44e-3, "B": 0.44e-3, "C": 0.48e-3, "D": 0.40e-3}  # m, 3-d rms that geometry alone leaves, at least
LEFT = {"A": 0.12e-3, "B": 0.18e-3, "C": 0.12e-3, "D": 0.15e-3}  # m, the same with what was found, at most
HALF = 0.16e-3  # m, the same of half of series A
SAGS = ("A", "B", "D")  # series of many postures, which show that the second link bends; C leaves it unexplained
GEOMETRY_FINDINGS = {"geometry_error", "joint_zero_offset"}  # geometry is refitted beforehand, so not in the rest

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")


@functools.cache
def _diagnose(cell_name: str, recording: str, test: str | None = None) -> Diagnosis:
    cell = load_cell(REAL / f"{cell_name}.cell.yaml")
    other = None if test is None else read_table(REAL / f"{test}.csv", cell)
    return diagnose_still(read_table(REAL / f"{recording}.csv", cell), cell, test=other)


def _ur10(series: str) -> Diagnosis:
    return _diagnose(f"ur10_{series}", f"ur10_{series}", "ur10_C" if series == "B" else None)


def _in_the_rest(found: Diagnosis) -> list[Finding]:
    """Return what was found in the rest that the refitted geometry leaves, without what is said of the geometry."""
    return [finding for finding in found.findings if finding.effect not in GEOMETRY_FINDINGS]


def _named(found: Diagnosis) -> set[tuple[str, str]]:
    return {(finding.effect, str(*finding.location.values())) for finding in _in_the_rest(found)}


def _gears(found: Diagnosis) -> Finding:
    """Return the finding that all gears err, with one shared size."""
    return next(f for f in found.findings if (f.effect, f.location) == ("transmission_error", {"joints": "all"}))


def test_ur5_all_gears_err_and_it_holds_on_unseen_poses() -> None:
    found = _diagnose("ur5", "ur5_grid", "ur5_random")
    assert found.test is not None
    assert found.identification.test is not None
    assert found.identification.test.mean > 0.100e-3  # geometry alone
    assert found.test.mean <= 0.060e-3
    assert found.stiffness == {}
    assert {name[0] for name in _named(found)} == {"transmission_error", "approach_direction"}
    gears = _gears(found)
    assert gears.shared_size is not None
    assert {p.name for p in gears.parameters} == {f"rms_error {joint}" for joint in found.identification.model.joints}
    assert all(after < 0.6 * before for before, after in found.blocks.values())
    assert found.verdict == "missing_physics"
    assert not found.anomalies


@pytest.mark.slow
def test_wam_is_left_where_it_came_from_and_not_elastic() -> None:
    found = _diagnose("wam", "wam_grid", "wam_random")
    assert found.findings[0].effect == "approach_direction"
    assert not [name for name in _named(found) if name[0] == "joint_elasticity"]
    assert found.test is not None
    assert found.test.mean <= 2.20e-3  # geometry alone: 3.09
    assert all(after < 0.8 * before for before, after in found.blocks.values())


@pytest.mark.slow
@pytest.mark.parametrize("series", UR10)
def test_ur10_all_gears_err(series: str) -> None:
    found = _ur10(series)
    gears = _gears(found)
    assert found.findings[0] is gears
    assert gears.held_out_gain > 0.8
    assert gears.log_bayes_factor > 500
    assert len(gears.parameters) == 6
    assert all(before > GEOMETRY[series] and after < LEFT[series] for before, after in found.blocks.values())


@pytest.mark.slow
def test_ur10_what_is_named_first_on_a_holds_on_the_others() -> None:
    first = {(_ur10(series).findings[0].effect, str(_ur10(series).findings[0].location)) for series in UR10}
    assert len(first) == 1


@pytest.mark.slow
@pytest.mark.parametrize("half", [0, 1])
def test_ur10_half_of_a_recording_names_all_gears(half: int) -> None:
    """Every other one of ten blocks in time: gears save less of the postures left out, and are named all the same."""
    cell = load_cell(REAL / "ur10_A.cell.yaml")
    readings = read_table(REAL / "ur10_A.csv", cell)
    blocks = np.searchsorted(np.linspace(0, len(readings), 11)[1:], np.arange(len(readings)), side="right")
    found = diagnose_still(readings.select(blocks % 2 == half), cell)
    assert found.findings[0] is _gears(found)
    assert found.verdict == "missing_physics"
    assert all(after < HALF for _, after in found.blocks.values())


@pytest.mark.slow
def test_ur10_what_is_found_on_one_predicts_another() -> None:
    """On another day, tracker pose and target fitted to it; of the robot, nothing is."""
    test = _ur10("B").test
    assert test is not None
    (at_rest,) = test.parts
    assert at_rest.mean_before > 0.4e-3
    assert at_rest.mean < 0.6 * at_rest.mean_before


@pytest.mark.slow
@pytest.mark.parametrize("series", UR10)
def test_ur10_what_sags_is_its_second_link_and_no_joint(series: str) -> None:
    """No stiffness of a joint is claimed where the bending of a tube explains more."""
    found = _ur10(series)
    assert found.stiffness == {}
    assert not [name for name in _named(found) if name[0] == "joint_elasticity"]
    bends = [finding for finding in found.findings if finding.effect == "link_bending"]
    assert [dict(finding.location) for finding in bends] == ([{"link": "link_2"}] if series in SAGS else [])
    assert all(finding.held_out_gain > 0.2 for finding in bends)
    assert found.verdict == ("missing_physics" if series in SAGS else "partly_explained")


@pytest.mark.slow
def test_ma1400_the_part_that_stands_apart_is_an_anomaly_and_no_physics() -> None:
    found = _diagnose("motoman", "motoman")
    moved = next(a for a in found.anomalies if a.kind in {"target_moved", "tracker_moved"})
    assert moved.configurations in {(1, 79), (1, 80)}
    assert all(after < 0.275 * before for before, after in found.blocks.values())  # 0.267 with negative compliances
    compliances = [p for f in found.findings if f.family in {"structure", "absolute"} for p in f.parameters]
    assert len(compliances) >= 20
    assert all(p.value >= 0 for p in compliances if "xy" not in p.name and "_12" not in p.name and p.unit != "rad")
    assert found.findings[0].effect in {
        "joint_elasticity",
        "off_axis_compliance",
    }  # it sags; whose masses, nobody knows
    assert {"joint_elasticity", "off_axis_compliance", "transmission_error"} <= {name[0] for name in _named(found)}
