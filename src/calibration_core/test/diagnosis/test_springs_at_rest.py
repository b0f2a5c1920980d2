"""Springs of laws that the catalogue does not hold, in postures at rest; gears and zero offsets are none."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from spring_plant import GEAR, LOADS, SPRING, Plant, named, of_every_kind, place, recorded, springs_are_named

from calibration_core.diagnosis.positions import diagnose_still
from calibration_core.diagnosis.result.finding import Diagnosis

ZERO = ("joint_zero_offset", "joint_2")
LARGE_ZERO = 2e-3  # rad
HIDDEN = "At rest a zero offset of joint_2 moves the points as the mean torque of a spring does"
WAVES = (((3, 4.0),), ((2, 3.0), (5, 1.8)), ((4, 3.0), (5, 1.8)), ((3, 2.0), (7, 1.2)), ((9, 3.5),))
FIRST = 2000  # seed of the slow tests


def diagnosed(plant: Plant) -> Diagnosis:
    cell, readings = recorded(plant)
    return diagnose_still(readings, cell)


@pytest.mark.parametrize(("kind", "settled"), [("hydraulic", False), ("counterweight", True)])
def test_a_spring_of_any_law_is_named_and_explains_the_recording(kind: str, settled: bool) -> None:
    found = diagnosed(Plant(1, kind))
    (finding,) = found.findings
    assert place(finding) == SPRING
    assert finding.law_settled is settled
    assert HIDDEN in finding.explanation
    assert found.verdict == "missing_physics"
    assert found.rms_after < 1.1 * found.noise
    assert found.noise < 0.5 * found.rms_before


def test_a_gear_beside_a_spring_is_named_too() -> None:
    assert named(diagnosed(Plant(3, "gas", waves=((7, 2.0),)))) == {SPRING, GEAR}


def test_a_large_error_of_a_gear_is_no_spring() -> None:
    assert named(diagnosed(Plant(5, waves=WAVES[1]))) == {GEAR}


def test_a_zero_offset_is_no_spring() -> None:
    assert named(diagnosed(Plant(5, zero=LARGE_ZERO))) == {ZERO}


def test_a_robot_without_a_spring_has_none() -> None:
    assert diagnosed(Plant(5)).findings == ()


def test_a_zero_offset_beside_a_spring_may_be_its_mean_torque() -> None:
    found = {place(one): one for one in diagnosed(Plant(5, "gas", zero=6e-4)).findings}
    assert set(found) == {SPRING, ZERO}
    (first, *_) = found[ZERO].cannot_be_told_from
    assert (first.effect, dict(first.location)) == ("gravity_compensator", {"joint": "joint_2"})


def test_a_floor_that_slopes_is_no_gear() -> None:
    (finding,) = diagnosed(Plant(7, slope=np.radians(0.6), geometry=True)).findings
    assert place(finding) == ("gravity_direction", "base")
    turned = np.linalg.norm([one.value for one in finding.parameters])
    assert turned == pytest.approx(np.radians(0.6), rel=0.15)  # stiffnesses are stated to 5 %


@pytest.mark.parametrize("hose", [(2, 1), (4, 3)])
def test_a_hose_that_winds_up_is_no_gear(hose: tuple[int, int]) -> None:
    (finding,) = diagnosed(Plant(8, hose=hose, geometry=True)).findings
    assert finding.effect == "cable_force"
    assert finding.variant.endswith(f"joint_{hose[0] + 1}")


@pytest.mark.slow
def test_smooth_laws_of_an_angle_are_no_gears() -> None:
    """Floors that slope, and hoses of two laws at four joints."""
    slopes = [Plant(3000 + k, rated=LOADS[k % 3], slope=np.radians(0.5 + 0.25 * k), geometry=True) for k in range(10)]
    hoses = itertools.product((1, 2, 4, 5), (1, 3), LOADS[:2])
    several = [*slopes, *(Plant(3100 + k, rated=r, hose=(j, p), geometry=True) for k, (j, p, r) in enumerate(hoses))]
    found = [{effect for effect, _ in named(diagnosed(plant))} for plant in several]
    assert sum("transmission_error" in one for one in found) <= 0.1 * len(found)


@pytest.mark.slow
def test_springs_of_every_law_are_named_and_no_gear() -> None:
    assert springs_are_named([diagnosed(plant) for plant in of_every_kind(FIRST)])


@pytest.mark.slow
@pytest.mark.parametrize("rated", LOADS)
@pytest.mark.parametrize("waves", WAVES)
def test_no_gear_is_a_spring(waves: tuple[tuple[int, float], ...], rated: int) -> None:
    """But for waves of one turn, which weight and springs are, too."""
    for seed in range(FIRST, FIRST + 3):
        found = named(diagnosed(Plant(seed, "", rated, waves, geometry=bool(seed % 2))))
        assert GEAR in found
        assert SPRING not in found


@pytest.mark.slow
@pytest.mark.parametrize("rated", LOADS)
def test_no_zero_offset_is_a_spring(rated: int) -> None:
    for seed in range(FIRST, FIRST + 6):
        found = diagnosed(Plant(seed, "", rated, zero=LARGE_ZERO, geometry=bool(seed % 2)))
        assert named(found) <= {ZERO}
