"""The simulated wrench beside the recorded one: the measured positions say which of the two is wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from robots import loaded_readings, write_cell
from scipy.spatial.transform import Rotation

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.recordings import compare
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.nominal import nominal_parameters
from calibration_core.timeseries import Float2D, Readings


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def recorded(cell: Cell) -> Readings:
    return loaded_readings(cell, 3)


def simulated(recorded: Readings, cell: Cell, wrench: Float2D) -> Readings:
    """What the cell file's model says of the same angles and other wrenches."""
    loaded = dataclasses.replace(recorded, wrench=wrench)
    return dataclasses.replace(loaded, position=predict_readings(loaded, cell, nominal_parameters(cell)))


def turned(wrench: Float2D) -> Float2D:
    turn = Rotation.from_rotvec([0.0, np.radians(5.0), 0.0]).as_matrix()
    return np.hstack([wrench[:, :3] @ turn.T, wrench[:, 3:] @ turn.T])


def scaled(wrench: Float2D) -> Float2D:
    return wrench * [1.0, 1.12, 1.0, 1.0, 1.0, 1.0]


def limited(wrench: Float2D) -> Float2D:
    most = 0.6 * np.abs(wrench[:, 2]).max()
    return np.column_stack([wrench[:, :2], np.clip(wrench[:, 2], -most, most), wrench[:, 3:]])


FAULTS = [(turned, "turned by 5.0 degrees"), (scaled, "fy +12.0 %"), (limited, "fz stops at")]


@pytest.mark.parametrize(("fault", "words"), FAULTS)
def test_the_wrong_sensor_is_named_and_refuses_nothing(
    recorded: Readings, cell: Cell, fault: Callable[[Float2D], Float2D], words: str
) -> None:
    assert recorded.wrench is not None
    true = simulated(recorded, cell, recorded.wrench)
    compared = compare(dataclasses.replace(recorded, wrench=fault(recorded.wrench)), true, cell)
    (one,) = compared.witnesses
    assert (one.what, one.wrong) == ("wrench", "recording")
    assert one.left is not None
    assert one.left[0] > 1.5 * one.left[1]
    assert words in one.text
    assert compared.steps is not None
    assert not any(difference.spoils for difference in compared.differences)


@pytest.mark.parametrize("fault", [fault for fault, _ in FAULTS])
def test_wrong_loads_in_a_simulation_are_the_simulations_fault(
    recorded: Readings, cell: Cell, fault: Callable[[Float2D], Float2D]
) -> None:
    assert recorded.wrench is not None
    compared = compare(recorded, simulated(recorded, cell, fault(recorded.wrench)), cell)
    assert [(one.what, one.wrong) for one in compared.witnesses] == [("wrench", "simulation")]
    assert compared.steps is not None


def test_the_noise_of_a_sensor_is_no_witness(recorded: Readings, cell: Cell) -> None:
    assert recorded.wrench is not None
    assert compare(recorded, simulated(recorded, cell, recorded.wrench), cell).witnesses == ()
    warm = dataclasses.replace(simulated(recorded, cell, recorded.wrench), temperature=recorded.temperature + 5.0)
    (one,) = compare(recorded, warm, cell).witnesses
    assert (one.what, one.wrong) == ("temperature", "either")
