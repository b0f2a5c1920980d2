"""Recording beside simulation: what is no physics is named, with the side that is off, before any physics."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.recordings import compare, sensor_axes
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.identification.stiffness.predict import from_step_zero, predict_readings
from calibration_core.model.chain import pose_matrix
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Readings


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def recorded(cell: Cell) -> Readings:
    return loaded_readings(cell, 3)


@pytest.fixture(scope="module")
def simulated(cell: Cell, recorded: Readings) -> Readings:
    """What the cell file's model says of the same angles and wrenches, without noise."""
    return dataclasses.replace(recorded, position=predict_readings(recorded, cell, nominal_parameters(cell)))


def by_model(readings: Readings, cell: Cell, **changes: object) -> Readings:
    model = nominal_parameters(cell).replace(**changes)
    return dataclasses.replace(readings, position=predict_readings(readings, cell, model))


def kinds(recorded: Readings, simulated: Readings, cell: Cell) -> dict[str, str]:
    return {d.kind: d.side for d in compare(recorded, simulated, cell).differences}


def test_a_simulation_by_the_same_model_differs_by_physics_alone(
    cell: Cell, recorded: Readings, simulated: Readings
) -> None:
    found = compare(recorded, simulated, cell)
    assert found.differences == ()
    assert found.reproduction.reproduced
    assert found.reproduction.loaded_ratio < 1e-6
    assert (found.configurations, found.readings) == (14, len(recorded))
    assert found.steps is not None
    assert found.steps.slope == pytest.approx(1.15, abs=0.02)  # the cell file is 15 % too stiff
    assert found.steps.rms > 3 * found.steps.noise
    assert found.steps.by_configuration[0].rms == max(part.rms for part in found.steps.by_configuration)
    middle = [part.rms for part in found.steps.by_step]
    assert middle[2] > middle[0]  # the full pull is step 2


def test_the_true_simulation_leaves_noise_alone(cell: Cell, recorded: Readings) -> None:
    found = compare(recorded, by_model(recorded, cell, compliance=1 / np.array(STIFFNESS)), cell)
    assert found.steps is not None
    assert found.steps.rms < found.steps.noise
    assert not found.reproduction.reproduced
    assert found.reproduction.refitted_ratio < 0.1
    for change in found.reproduction.stiffness_change.values():
        assert change == pytest.approx(1 / 1.15 - 1, abs=1e-3)


@pytest.mark.parametrize("off", ["simulation", "recording"])
def test_swapped_joints(cell: Cell, recorded: Readings, simulated: Readings, off: str) -> None:
    pair = {"recording": recorded, "simulation": simulated}
    pair[off] = dataclasses.replace(pair[off], q=pair[off].q[:, [0, 2, 1, 3, 4, 5]])
    found = compare(pair["recording"], pair["simulation"], cell)
    assert {d.kind: d.side for d in found.differences} == {"joints_swapped": off}
    assert found.differences[0].location == {"joint": "joint_2, joint_3"}
    assert found.steps is None


@pytest.mark.parametrize("off", ["simulation", "recording"])
def test_a_joint_of_opposite_sign_and_one_of_another_zero(
    cell: Cell, recorded: Readings, simulated: Readings, off: str
) -> None:
    pair = {"recording": recorded, "simulation": simulated}
    q = pair[off].q * [1, 1, -1, 1, 1, 1] + [0, 0, 0, 0, np.pi / 2, 0]
    pair[off] = dataclasses.replace(pair[off], q=q)
    found = compare(pair["recording"], pair["simulation"], cell)
    assert {d.kind: d.side for d in found.differences} == {"joint_sign": off, "joint_zero": off}
    zero = next(d for d in found.differences if d.kind == "joint_zero")
    assert (zero.location, zero.magnitude) == ({"joint": "joint_5"}, pytest.approx(np.pi / 2, abs=1e-6))


def test_degrees(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    off = dataclasses.replace(simulated, q=np.degrees(simulated.q))
    assert kinds(recorded, off, cell) == {"angle_unit": "simulation"}


@pytest.mark.parametrize("off", ["simulation", "recording"])
def test_millimetres(cell: Cell, recorded: Readings, simulated: Readings, off: str) -> None:
    ours = dataclasses.replace(recorded, position=recorded.position * (1e3 if off == "recording" else 1))
    theirs = dataclasses.replace(simulated, position=simulated.position * (1e3 if off == "simulation" else 1))
    assert kinds(ours, theirs, cell) == {"length_unit": off}


def test_points_that_exchanged_their_names(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    table = np.arange(len(simulated)).reshape(-1, 3)[:, [1, 0, 2]].reshape(-1)
    off = dataclasses.replace(simulated, position=simulated.position[table])
    found = compare(recorded, off, cell)
    assert {d.kind: d.side for d in found.differences} == {"points_swapped": "simulation"}
    assert found.differences[0].location == {"point": "mp1, mp2"}


def test_a_left_handed_frame(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    off = dataclasses.replace(simulated, position=simulated.position * [1, -1, 1])
    assert kinds(recorded, off, cell) == {"mirrored_axes": "simulation"}


def test_another_tracker_frame_is_said_and_taken_out(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    pose = pose_matrix(np.array([1.0, 2.0, -0.5]), np.array([0.1, 0.2, 1.5]))
    off = dataclasses.replace(simulated, position=simulated.position @ pose[:3, :3].T + pose[:3, 3])
    found = compare(recorded, off, cell)
    assert [(d.kind, d.side) for d in found.differences] == [("tracker_frame", "simulation")]
    plain = compare(recorded, simulated, cell)
    assert found.steps is not None
    assert plain.steps is not None
    assert found.steps.rms == pytest.approx(plain.steps.rms, rel=1e-3)
    assert not found.reproduction.reproduced


def test_another_robot(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    geometry = np.zeros((6, 6))
    geometry[1, 0] = 0.15
    off = by_model(simulated, cell, geometry=geometry)
    found = compare(recorded, off, cell)
    assert [(d.kind, d.side) for d in found.differences if d.spoils] == [("wrong_robot_file", "simulation")]


def in_base_axes(readings: Readings, cell: Cell) -> np.ndarray:
    axes = sensor_axes(readings, cell, chain_of(cell))
    assert readings.wrench is not None
    return np.hstack([np.einsum("mij,mj->mi", axes, part) for part in np.hsplit(readings.wrench, 2)])


def test_wrenches(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    w = np.array(simulated.wrench)
    changed = {
        "wrench_sign": [-w],
        "wrench_unit": [w / 1e3, w * 9.80665, np.hstack([w[:, :3], w[:, 3:] * 1e3])],
        "wrench_axes": [w[:, [1, 0, 2, 4, 3, 5]], in_base_axes(simulated, cell)],
        "wrench_reference": [np.hstack([w[:, :3], w[:, 3:] + np.cross([0.1, 0.2, 0.3], w[:, :3])])],
        "loads": [0 * w, np.random.default_rng(0).permutation(w)],
    }
    for kind, wrenches in changed.items():
        for wrench in wrenches:
            assert set(kinds(recorded, dataclasses.replace(simulated, wrench=wrench), cell)) == {kind}


@pytest.mark.parametrize("off", ["simulation", "recording"])
def test_the_side_whose_wrench_has_the_wrong_sign(
    cell: Cell, recorded: Readings, simulated: Readings, off: str
) -> None:
    pair = {"recording": recorded, "simulation": simulated}
    pair[off] = dataclasses.replace(pair[off], wrench=-np.array(pair[off].wrench))
    assert kinds(pair["recording"], pair["simulation"], cell) == {"wrench_sign": off}


def test_numbers_in_another_order_and_missing_steps(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    other = simulated.select(simulated.step != 4)
    other = dataclasses.replace(other, configuration=30 - other.configuration)
    found = compare(recorded, other.select(other.configuration > 18), cell)
    assert {d.kind for d in found.differences} == {"configurations", "steps"}
    assert found.configurations == 11
    assert found.steps is not None
    assert found.steps.slope == pytest.approx(1.15, abs=0.02)


def test_nothing_in_common(cell: Cell, recorded: Readings) -> None:
    other = loaded_readings(cell, 99)
    found = compare(recorded, other, cell)
    assert found.readings == 0
    assert found.steps is None
    assert "configurations" in {d.kind for d in found.differences}


def test_displacements_against_positions(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    off = dataclasses.replace(simulated, position=from_step_zero(simulated, simulated.position))
    assert kinds(recorded, off, cell)["displacements"] == "simulation"


def test_positions_without_loads_are_compared_too(cell: Cell, recorded: Readings) -> None:
    still = dataclasses.replace(recorded.select(recorded.step == 0), wrench=None)
    geometry = np.zeros((6, 6))
    geometry[2, 5] = 1e-3
    found = compare(still, by_model(still, cell, geometry=geometry), cell)
    assert found.differences == ()
    assert found.steps is not None
    assert np.isnan(found.steps.slope)
    assert found.steps.rms > 1e-4
    assert not found.reproduction.reproduced


def test_no_physics_is_claimed_of_a_recording_that_is_mixed_up(
    cell: Cell, recorded: Readings, simulated: Readings
) -> None:
    off = dataclasses.replace(recorded, wrench=-np.array(recorded.wrench))
    found = diagnose(off, cell, simulation=simulated)
    assert (found.verdict, found.findings) == ("consistent", ())
    assert [a.kind for a in found.anomalies][:1] == ["wrench_sign"]
    good = diagnose(recorded, cell, simulation=dataclasses.replace(simulated, wrench=-np.array(simulated.wrench)))
    assert good.verdict == "consistent"
    assert good.held_out_after == pytest.approx(good.noise, rel=0.2)
    (compared,) = good.comparisons
    assert Path(compared.simulation).name == "simulated.csv"
