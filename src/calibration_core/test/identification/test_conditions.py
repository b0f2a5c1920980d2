"""The standard's conditions while measuring: limits, values, verdicts, overrides, and what the report tells."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import loaded_readings, write_cell

from calibration_core.cell import Cell, EndEffector
from calibration_core.errors import CellError
from calibration_core.identification.checks.conditions import (
    NAMES,
    CellState,
    check_preconditions,
    judge,
    with_temperature_of,
)
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.end_effector import TOOL_COMPLIANCE, accounted, relative_stiffness
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.predict import shift_by_effects
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.observations.observe import worst
from calibration_core.report.content import build
from calibration_core.report.results.result import result_dict
from calibration_core.timeseries import Override, Readings

STATE = CellState(
    temperature=np.array([[0.0, 20.1], [1800.0, 20.4]]),
    mode="MANUAL_REDUCED",
    drives=True,
    warm_up_age=600.0,
    warm_up_period=3600.0,
    largest_force=2000.0,
    uncertainty_ratio=12.0,
    tool_stiffness=40.0,
    speed=0.2375,
)
WHO = Override("temperature", "A. Smith", "the air conditioning is out of order")


def verdicts(state: CellState, cell: Cell) -> dict[str, bool | None]:
    return {one.name: one.met for one in judge(state, cell)}


def test_a_good_cell_meets_every_condition(cell: Cell) -> None:
    found = judge(STATE, cell)
    assert tuple(one.name for one in found) == NAMES
    assert all(one.met for one in found), found
    assert all(one.limit and one.value and one.clause.startswith("5.") for one in found)
    assert not any(one.stops for one in found)


def test_what_cannot_be_seen_is_no_violation(cell: Cell) -> None:
    found = judge(CellState(np.empty((0, 2))), cell)
    unknown = {one.name for one in found if one.met is None}
    assert unknown == set(NAMES) - {"rated_load"}
    assert not any(one.stops for one in found)


@pytest.mark.parametrize(
    ("change", "name", "stops"),
    [
        ({"temperature": np.array([[0.0, 22.1]])}, "temperature", True),
        ({"temperature": np.array([[0.0, 17.9]])}, "temperature", True),
        ({"temperature": np.array([[0.0, 19.0], [3000.0, 20.5]])}, "temperature_stable", False),
        ({"warm_up_age": 6000.0}, "start_up", True),
        ({"largest_force": 1e5}, "rated_load", True),
        ({"uncertainty_ratio": 4.9}, "uncertainty_ratio", False),
        ({"drives": False}, "servo", True),
        ({"mode": "AUTOMATIC"}, "manual_mode", True),
        ({"mode": "EXTERNAL"}, "manual_mode", True),
        ({"speed": 0.3}, "reduced_speed", True),
    ],
)
def test_a_violated_shall_stops_and_a_should_does_not(
    cell: Cell, change: dict[str, object], name: str, stops: bool
) -> None:
    found = {one.name: one for one in judge(dataclasses.replace(STATE, **change), cell)}  # type: ignore[arg-type]
    assert found[name].met is False
    assert found[name].stops is stops
    assert [one for one in found if found[one].met is False] == [name]


def test_old_changes_of_temperature_do_not_count(cell: Cell) -> None:
    warm = np.array([[0.0, 18.5], [7000.0, 20.0], [10_000.0, 20.1]])
    assert verdicts(dataclasses.replace(STATE, temperature=warm), cell)["temperature_stable"] is True


def test_a_short_look_says_nothing_of_an_hour(cell: Cell) -> None:
    short, half = np.array([[0.0, 20.0], [60.0, 20.1]]), np.array([[0.0, 20.0], [1800.0, 20.4]])
    assert verdicts(dataclasses.replace(STATE, temperature=short), cell)["temperature_stable"] is None
    assert verdicts(dataclasses.replace(STATE, temperature=half), cell)["temperature_stable"] is True


def test_a_thermometer_that_is_silent_shows_no_temperature(cell: Cell) -> None:
    silent = dataclasses.replace(STATE, temperature=np.array([[0.0, 20.0], [1800.0, 20.1], [1900.0, np.nan]]))
    found = {one.name: one for one in judge(silent, cell)}
    assert (found["temperature"].value, found["temperature"].met) == ("the thermometer is silent", None)
    assert found["temperature_stable"].met is True


def test_a_soft_end_effector_is_accounted_for(cell: Cell) -> None:
    found = {one.name: one for one in judge(dataclasses.replace(STATE, tool_stiffness=2.0), cell)}
    assert found["end_effector"].met is True
    assert "accounted for" in found["end_effector"].value


def test_an_override_by_name_lets_the_run_go_on(cell: Cell) -> None:
    hot = dataclasses.replace(STATE, temperature=np.array([[0.0, 25.0]]))
    found = {one.name: one for one in judge(hot, cell, [WHO])}
    assert (found["temperature"].met, found["temperature"].stops) == (False, False)
    assert found["temperature"].override == WHO
    assert found["servo"].override is None


def test_over_a_measurement_the_worst_counts(cell: Cell) -> None:
    hot = judge(dataclasses.replace(STATE, temperature=np.array([[0.0, 23.0]])), cell)
    overridden = judge(dataclasses.replace(STATE, temperature=np.array([[0.0, 24.0]])), cell, [WHO])
    unknown = judge(dataclasses.replace(STATE, drives=None), cell)
    found = {one.name: one for one in worst([unknown, judge(STATE, cell), hot, overridden, judge(STATE, cell)])}
    assert (found["temperature"].met, found["temperature"].value) == (False, "23.0 °C")
    assert found["temperature"].override == WHO
    assert found["servo"].met is True
    assert worst([]) == ()


def test_report_and_result_tell_limit_value_verdict_and_who_overrode(cell: Cell) -> None:
    hot = dataclasses.replace(STATE, temperature=np.array([[0.0, 25.0]]))
    readings = dataclasses.replace(loaded_readings(cell, 1), conditions=judge(hot, cell, [WHO]))
    found = identify(readings, cell)
    checks = {one.name: one for one in found.preconditions if one.name}
    assert set(NAMES) <= set(checks)
    assert (checks["temperature"].met, "25.0 °C" in checks["temperature"].found) == (False, True)
    assert checks["temperature"].override == "A. Smith: the air conditioning is out of order"
    assert checks["manual_mode"].met is True
    rows = {row["name"]: row for row in result_dict(found, cell)["preconditions"]}
    assert rows["temperature"]["override"].startswith("A. Smith")
    assert "A. Smith" in str(build(found, cell))


def test_without_a_suite_the_report_says_what_was_not_seen(cell: Cell) -> None:
    found = identify(loaded_readings(cell, 1), cell)
    unseen = [one for one in found.preconditions if one.found == "not contained in the evaluated data"]
    assert [one.clause for one in unseen] == ["5.1", "5.2"]


def test_a_reference_that_is_visited_without_load_is_no_configuration_of_the_standard(cell: Cell) -> None:
    readings = loaded_readings(cell, 1, configurations=12)
    assert readings.wrench is not None
    first = readings.configuration == 1
    visited = dataclasses.replace(readings, wrench=np.where(first[:, None], 0.0, readings.wrench))
    checks = {one.requirement: one for one in identify(visited, cell).preconditions}
    twelve = checks["at least 12 manipulator configurations"]
    assert (twelve.found, twelve.met) == ("11 configurations", False)
    report = str(build(identify(visited, cell), cell))
    assert "12 configurations (1 of them visited without load); the standard asks for at least 12" in report
    assert "Configuration 1 was visited without load." in report


@pytest.mark.parametrize(
    ("stated", "start", "found", "met"),
    [
        ("2025-11-20", "2026-01-05T08:00:00+00:00", "2025-11-20", True),
        ("2026-01-05", "2026-01-05T08:00:00+00:00", "2026-01-05", True),
        ("2026-01-06", "2026-01-05T08:00:00+00:00", "2026-01-06, which is after the measurement of 2026-01-05", False),
        ("2031-01-15", "", "2031-01-15; the recording does not say when it was measured", None),
        ("not yet", "2026-01-05T08:00:00+00:00", "“not yet” in the cell file, which is no date (YYYY-MM-DD)", None),
        ("", "2026-01-05T08:00:00+00:00", "no calibration date in the cell file", None),
    ],
)
def test_an_instrument_is_calibrated_before_it_measures(
    tmp_path: Path, stated: str, start: str, found: str, met: bool | None
) -> None:
    instruments = {
        "tracker": {"sigma": 2.0e-5, "calibrated": stated},
        "temperature": {"sigma": 0.1, "calibrated": stated},
    }
    cell = write_cell(tmp_path, instruments=instruments)
    readings = loaded_readings(cell, 1)
    dated = dataclasses.replace(readings, provenance=dataclasses.replace(readings.provenance, start=start))
    checks = {one.requirement: one for one in identify(dated, cell).preconditions}
    for instrument in ("laser tracker", "thermometer"):
        check = checks[f"{instrument} calibrated"]
        assert (check.found, check.met) == (found, met)


def requirement(readings: Readings, cell: Cell, part: str, options: Options | None = None) -> tuple[str, bool | None]:
    (check,) = (one for one in identify(readings, cell, options).preconditions if part in one.requirement)
    return check.found, check.met


def test_the_temperature_of_every_reading_counts(cell: Cell) -> None:
    readings = loaded_readings(cell, 1)
    assert readings.wrench is not None
    first = readings.configuration == 1
    visited = dataclasses.replace(readings, wrench=np.where(first[:, None], 0.0, readings.wrench))
    hot = dataclasses.replace(visited, temperature=np.where(first, 35.0, 20.4))
    assert requirement(hot, cell, "± 2 °C") == ("20.4 to 35.0 °C", False)
    some = dataclasses.replace(readings, temperature=np.where(first, 20.4, np.nan))
    known = f"20.4 to 20.4 °C, known of {first.sum()} of {len(first)} readings"
    assert requirement(some, cell, "± 2 °C") == (known, None)


def test_the_temperature_of_every_phase_counts(cell: Cell) -> None:
    checks = identify(loaded_readings(cell, 1), cell).preconditions
    other = loaded_readings(cell, 2)
    hot = dataclasses.replace(other, temperature=np.full(len(other), 23.0), conditions=judge(STATE, cell, [WHO]))
    (whole,) = (one for one in with_temperature_of(checks, hot) if one.name == "temperature")
    assert (whole.found, whole.met, whole.override) == ("23.0 to 23.0 °C", False, f"{WHO.operator}: {WHO.reason}")


def test_a_posture_that_is_measured_twice_is_one_configuration(cell: Cell) -> None:
    readings = loaded_readings(cell, 1, configurations=12)
    assert requirement(readings, cell, "12 manipulator configurations") == ("12 configurations", True)
    again = readings.q.copy()
    again[readings.configuration == 2] = again[readings.configuration == 1][0] + 1e-4
    twice = dataclasses.replace(readings, q=again)
    found = ("12 configurations in 11 different postures", False)
    assert requirement(twice, cell, "12 manipulator configurations") == found


def test_every_configuration_is_measured_without_load_too(cell: Cell) -> None:
    readings = loaded_readings(cell, 1)
    found = ("14 of 14 configurations", True)
    assert requirement(readings, cell, "unloaded position") == found
    force = np.linalg.norm(readings.wrench[:, :3], axis=1) if readings.wrench is not None else np.zeros(0)
    without = readings.select((readings.configuration > 1) | (force > 100.0))
    assert requirement(without, cell, "unloaded position") == ("13 of 14 configurations", False)


def test_the_load_counts_with_the_end_effector_and_above_the_limit_is_not_met(cell: Cell) -> None:
    """101 % is more than 100 %; where the sensor cannot tell, it stays open."""
    readings = loaded_readings(cell, 1)
    largest = float(np.linalg.norm(readings.wrench[:, :3], axis=1).max()) if readings.wrench is not None else 0.0
    asked = "100 % of the rated load"

    def rated(kilograms: float, **changes: object) -> tuple[str, bool | None]:
        robot = cell.robot.model_copy(update={"rated_load": kilograms})
        return requirement(readings, cell.model_copy(update={"robot": robot, **changes}), asked)

    assert rated(largest / 9.80665 / 0.99)[1] is True
    assert rated(largest / 9.80665 / 1.2)[1] is False
    within = rated((largest - cell.instruments.force_torque.sigma_force) / 9.80665)
    assert within[1] is None
    assert "stays open" in within[0]
    tool = EndEffector(mass=0.3 * largest / 9.80665)
    found, met = rated(largest / 9.80665 / 0.99, end_effector=tool)
    assert met is False
    assert "with the end effector's weight" in found


def test_a_mass_alone_says_nothing_of_stiffness(cell: Cell) -> None:
    stated = cell.model_copy(update={"end_effector": EndEffector(mass=1.0)})
    assert accounted(stated, None) is None
    assert np.isnan(relative_stiffness(stated, np.full((1, 6), 0.1)))
    assert requirement(loaded_readings(cell, 1), stated, "end effector") == ("its stiffness is not stated", None)
    with pytest.raises(ValueError, match="who states how the end effector gives way"):
        EndEffector(mass=1.0, rotation=(1e-7, 1e-7, 1e-7))


def test_noise_alone_is_half_of_its_expanded_uncertainty(cell: Cell) -> None:
    """The length of a deflection is compared with the uncertainty of a length, not with that of a coordinate."""
    readings, sigma = loaded_readings(cell, 1), 2e-5
    space = identify(readings, cell).space
    noise = np.sqrt(2) * sigma * np.random.default_rng(1).standard_normal((len(space.configuration), 3))
    noise *= np.sqrt(6) * sigma / np.sqrt(np.mean(np.sum(noise**2, axis=1)))
    checks = check_preconditions(readings, cell, dataclasses.replace(space, deflection=noise), sigma)
    (ratio,) = (one.found for one in checks if "uncertainty ratio" in one.requirement)
    assert ratio.startswith("1:0.5 ")


def test_the_report_says_whether_k_csm_is_neglected(cell: Cell) -> None:
    readings = loaded_readings(cell, 1)
    assert "; neglecting K_CSM would move points" in requirement(readings, cell, "singularities")[0]
    linear = requirement(readings, cell, "singularities", Options(method="linear"))
    assert "; K_CSM, which this method neglects, moves points" in linear[0]


SOFT = EndEffector(rotation=(4e-7, 6e-7, 2e-7), translation=(1e-8, 1e-8, 2e-8), source="finite elements")


def test_the_stated_compliance_of_the_tool_is_taken_off(cell: Cell) -> None:
    """Readings of a cell with a soft tool give the joints' stiffnesses if the cell file states the tool."""
    stated = cell.model_copy(update={"end_effector": SOFT})
    given = accounted(stated, None)
    assert given is not None
    readings = loaded_readings(cell, 4, noise=0.0)
    moved = applied_to(readings, cell, given)
    true = np.array([joint.value for joint in identify(readings, cell).stiffness])
    biased = np.array([joint.value for joint in identify(moved, cell).stiffness])
    freed = np.array([joint.value for joint in identify(moved, stated).stiffness])
    assert np.abs(freed / true - 1).max() < 2e-3
    assert np.abs(biased / true - 1).max() > 2e-2


def applied_to(readings: Readings, cell: Cell, given: GivenModel) -> Readings:
    """Return readings moved by what the effects of a model say."""
    shift = shift_by_effects(readings, cell, given.parameters) @ given.parameters.tracker[:3, :3]
    return dataclasses.replace(readings, position=readings.position + shift)


def test_a_model_that_knows_the_tool_keeps_what_it_found(cell: Cell) -> None:
    stated = cell.model_copy(update={"end_effector": SOFT})
    once = accounted(stated, None)
    assert once is not None
    assert accounted(stated, once) is once
    other = GivenModel(nominal_parameters(cell), "model.yaml", "0")
    both = accounted(stated, other)
    assert both is not None
    assert [one.effect for one in both.parameters.effects] == [TOOL_COMPLIANCE]
    assert accounted(cell, None) is None
    lost = stated.model_copy(update={"frames": stated.frames.model_copy(update={"tracker": None})})
    with pytest.raises(CellError, match="tracker"):
        accounted(lost, None)


def test_the_stiffness_of_the_tool_beside_that_of_the_robot(cell: Cell) -> None:
    q = np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]])
    assert np.isnan(relative_stiffness(cell, q))
    soft, stiff = (
        relative_stiffness(cell.model_copy(update={"end_effector": tool}), q)
        for tool in (SOFT, SOFT.model_copy(update={"translation": (0.0, 0.0, 0.0), "rotation": (2e-9, 3e-9, 1e-9)}))
    )
    assert 0.0 < soft < stiff
