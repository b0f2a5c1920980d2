"""Springs of laws that the catalogue does not hold, where some of the postures are loaded, too."""

from __future__ import annotations

import pytest
from spring_plant import GEAR, LOADS, SIZES, SPRING, STIFFNESS, Plant, named, of_every_kind, recorded, springs_are_named

from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.result.finding import Diagnosis

SOFT = ("soft_zone", "joint_2")
LOADED = (4, 10, 20)  # configurations
WAVES = (((3, 4.0),), ((2, 3.0), (5, 1.8)))
FIRST = 4000  # seed of the slow tests


def diagnosed(plant: Plant) -> Diagnosis:
    cell, readings = recorded(plant)
    return diagnose(readings, cell)


def test_a_spring_of_any_law_is_named_beside_loads_and_explains_the_recording() -> None:
    found = diagnosed(Plant(2036, "hydraulic", 500, loaded=4))
    assert named(found) == {SPRING}
    assert found.verdict == "missing_physics"
    assert found.rms_after < 1.1 * found.noise
    assert found.noise < 0.5 * found.rms_before


@pytest.mark.slow
def test_the_law_of_a_joint_is_found_beside_its_spring() -> None:
    assert {SPRING, SOFT} <= named(diagnosed(Plant(2039, "counterweight", 500, loaded=10, soft=True, geometry=True)))


def test_loaded_configurations_that_follow_each_other_are_not_all_left_out() -> None:
    """Four, one after the other: nothing else tells the compliances.  A gear's error beside them is no spring."""
    assert named(diagnosed(Plant(4000, "", 500, WAVES[1], loaded=4))) == {GEAR}


def test_a_robot_without_a_spring_has_none_beside_loads() -> None:
    assert diagnosed(Plant(2010, "", 60, loaded=10)).findings == ()


@pytest.mark.parametrize("seed", [7102, pytest.param(7112, marks=pytest.mark.slow)])
def test_a_compliance_that_only_the_weight_tells_is_where_the_recording_puts_it(seed: int) -> None:
    """The loads turn nothing about joint 6; what they seem to tell of it is ten times the truth."""
    rated = LOADS[seed % 3]
    value, std = diagnosed(Plant(seed, "", rated, loaded=4)).stiffness["joint_6"]
    compliance = 1 / (STIFFNESS[5] * SIZES[rated][2])
    assert abs(1 / value - compliance) < 2 * std / value**2


@pytest.mark.slow
def test_springs_of_every_law_are_named_beside_loads_and_no_gear() -> None:
    assert springs_are_named([diagnosed(plant) for plant in of_every_kind(FIRST, LOADED)])


@pytest.mark.slow
@pytest.mark.parametrize("rated", LOADS)
@pytest.mark.parametrize("waves", WAVES)
def test_no_gear_is_a_spring_beside_loads(waves: tuple[tuple[int, float], ...], rated: int) -> None:
    for k, loaded in enumerate(LOADED):
        found = named(diagnosed(Plant(FIRST + k, "", rated, waves, loaded=loaded, geometry=bool(k % 2))))
        assert GEAR in found
        assert SPRING not in found
