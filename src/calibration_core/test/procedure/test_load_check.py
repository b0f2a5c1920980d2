"""The load that pulls against the load that was planned: sensor axes, tool weight and tares included."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.measurement.load_check import Felt, LoadCheck
from calibration_core.model.chain import pose_matrix
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.planning.plans.plan import PlannedConfiguration
from calibration_core.planning.plans.tolerances import Tolerances
from calibration_core.timeseries import Float1D

WANTED = np.array([300.0, -400.0, -2000.0, 0.0, 0.0, 0.0])
TOOL = np.array([11.0, -7.0, 350.0, 4.0, 9.0, -2.0])  # what the sensor says anyway: weight of the tool, bias


def felt(cell: Cell, q: Float1D, wrench: Float1D, tare: int = 0) -> Felt:
    """What the cell's model says that the sensor shows under a wrench at the wrench point, and the tool's weight."""
    parameters = nominal_parameters(cell)
    rigid = dataclasses.replace(parameters, compliance=np.zeros_like(parameters.compliance))
    readings = simulate_plan([PlannedConfiguration(1, q, wrench[None, :])], cell, rigid)
    assert readings.wrench is not None
    return Felt(q, readings.wrench[0] + TOOL, tare)


@pytest.fixture(scope="module")
def postures() -> np.ndarray:
    return np.random.default_rng(5).uniform(-1.2, 1.2, (20, 6))


def test_the_load_as_planned(demo_cell: Cell, postures: np.ndarray) -> None:
    check = LoadCheck(demo_cell, Tolerances())
    for q in postures:
        unloaded = felt(demo_cell, q, np.zeros(6))
        found = check.acting_load(felt(demo_cell, q, WANTED), unloaded)
        np.testing.assert_allclose(found, WANTED, atol=1e-6)
        assert check.fault(WANTED, felt(demo_cell, q, WANTED), unloaded) == ""
        assert check.fault(np.zeros(6), unloaded, unloaded) == ""


@pytest.mark.parametrize(
    ("share", "word"), [(0.0, "(size 0,"), (0.85, "(size 1752,"), (1.15, "(size 2371,"), (-1.0, "(180.0° from the")]
)
def test_another_size(demo_cell: Cell, postures: np.ndarray, share: float, word: str) -> None:
    check = LoadCheck(demo_cell, Tolerances())
    for q in postures:
        text = check.fault(WANTED, felt(demo_cell, q, share * WANTED), felt(demo_cell, q, np.zeros(6)))
        assert text.startswith("force: wanted (300, -400, -2000) N, found (")
        assert word in text
        assert "apply the load as wanted" in text


@pytest.mark.parametrize(("degrees", "right"), [(8.0, True), (12.0, False), (90.0, False)])
def test_another_direction(demo_cell: Cell, postures: np.ndarray, degrees: float, right: bool) -> None:
    check = LoadCheck(demo_cell, Tolerances())
    across = np.cross(WANTED[:3], [1.0, 0.0, 0.0])
    across *= np.linalg.norm(WANTED[:3]) / np.linalg.norm(across)
    angle = np.deg2rad(degrees)
    turned = np.concatenate([np.cos(angle) * WANTED[:3] + np.sin(angle) * across, np.zeros(3)])
    for q in postures:
        text = check.fault(WANTED, felt(demo_cell, q, turned), felt(demo_cell, q, np.zeros(6)))
        assert (text == "") is right
        if not right:
            assert f"{degrees:.1f}° from the direction wanted, expected at most 9.7°" in text


def test_the_band_is_the_one_that_faults_are_found_by(demo_cell: Cell, postures: np.ndarray) -> None:
    check = LoadCheck(demo_cell, Tolerances())
    size, angle = check.force_band(WANTED)
    assert (size, angle) == (pytest.approx(0.1 * np.linalg.norm(WANTED)), 0.17)
    unloaded, unit = felt(demo_cell, postures[0], np.zeros(6)), WANTED / np.linalg.norm(WANTED)
    for share, right in ((0.99, True), (1.01, False)):
        pulled = felt(demo_cell, postures[0], WANTED + share * size * unit)
        assert (check.fault(WANTED, pulled, unloaded) == "") is right
    size, angle = check.force_band(np.zeros(6))
    assert size == check.floor
    assert np.isnan(angle)


def test_what_stays_on_when_released(demo_cell: Cell, postures: np.ndarray) -> None:
    check = LoadCheck(demo_cell, Tolerances())
    unloaded = felt(demo_cell, postures[0], np.zeros(6))
    assert "release the load" in check.fault(np.zeros(6), felt(demo_cell, postures[0], 0.05 * WANTED), unloaded)
    assert check.fault(np.zeros(6), felt(demo_cell, postures[0], 0.02 * WANTED), unloaded) == ""


def test_a_tare_in_between(demo_cell: Cell, postures: np.ndarray) -> None:
    """It would make the load vanish."""
    check = LoadCheck(demo_cell, Tolerances())
    unloaded, loaded = felt(demo_cell, postures[0], np.zeros(6)), felt(demo_cell, postures[0], WANTED, tare=1)
    assert "tared (tare 1, before 0)" in check.fault(WANTED, loaded, unloaded)


def test_a_torque_is_held_against_the_plan_too(demo_cell: Cell, postures: np.ndarray) -> None:
    check = LoadCheck(demo_cell, Tolerances())
    wanted = WANTED + np.array([0.0, 0.0, 0.0, 80.0, 0.0, 0.0])
    q = postures[0]
    assert check.fault(wanted, felt(demo_cell, q, wanted), felt(demo_cell, q, np.zeros(6))) == ""
    assert check.fault(wanted, felt(demo_cell, q, WANTED), felt(demo_cell, q, np.zeros(6))).startswith("torque: wanted")


def test_axes_and_point_are_those_of_the_cell_file(demo_cell: Cell, postures: np.ndarray) -> None:
    """A wrench that is recorded in base axes, at the wrench point, is taken as that."""
    convention = demo_cell.measurements.model_copy(update={"wrench_axes": "base", "wrench_at": "wrench_point"})
    cell = demo_cell.model_copy(update={"measurements": convention})
    check = LoadCheck(cell, Tolerances())
    np.testing.assert_allclose(check.pulls(Felt(postures[0], WANTED)), WANTED, atol=1e-9)
    sensor = demo_cell.frames.force_torque
    assert sensor is not None
    assert not np.allclose(pose_matrix(np.array(sensor.xyz), np.array(sensor.rpy)), np.eye(4))


def test_the_floor_comes_from_rated_load_and_sensor(demo_cell: Cell) -> None:
    assert Tolerances().floor(demo_cell) == pytest.approx(0.02 * 240.0 * 9.80665)
    assert Tolerances(force_floor=3.0).floor(demo_cell) == 3.0
