"""What both recordings say of wrench, angles and time: the measured positions say which of the two is wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.result import Comparison
from calibration_core.diagnosis.diagnose import beside, diagnose
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.diagnosis.simulated import compare_checked
from calibration_core.diagnosis.waterfall import with_waterfall
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float2D, Readings


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


@pytest.fixture(scope="module")
def found(recorded: Readings, cell: Cell) -> Diagnosis:
    """What is found of the recording as it is: the same model is fitted to recordings with faults, too."""
    return diagnose(recorded, cell)


def judged(found: Diagnosis, recorded: Readings, simulation: Readings, cell: Cell) -> Comparison:
    compared = compare_checked(recorded, simulation, cell)
    return with_waterfall(beside(found, [compared]), recorded, cell).comparisons[0]


@pytest.mark.parametrize(("fault", "words"), FAULTS)
def test_the_wrong_sensor_is_named_and_refuses_nothing(
    found: Diagnosis, recorded: Readings, cell: Cell, fault: Callable[[Float2D], Float2D], words: str
) -> None:
    assert recorded.wrench is not None
    true = simulated(recorded, cell, recorded.wrench)
    compared = judged(found, dataclasses.replace(recorded, wrench=fault(recorded.wrench)), true, cell)
    (one,) = compared.witnesses
    assert (one.what, one.wrong) == ("wrench", "recording")
    assert one.left is not None
    assert one.left[0] > 1.2 * one.left[1]
    assert words in one.text
    assert one.text in compared.sentences
    assert not any(difference.spoils for difference in compared.differences)


def test_wrong_loads_in_a_simulation_are_the_simulations_fault(
    found: Diagnosis, recorded: Readings, cell: Cell
) -> None:
    assert recorded.wrench is not None
    compared = judged(found, recorded, simulated(recorded, cell, turned(recorded.wrench)), cell)
    assert [(one.what, one.wrong) for one in compared.witnesses] == [("wrench", "simulation")]


def test_a_sensor_is_seen_beside_missing_physics(recorded: Readings, cell: Cell) -> None:
    """A bearing that gives way leaves many times what the sensor's fault does."""
    size = {"compliance_x": 4e-7, "compliance_y": 3e-7, "compliance_xy": 0.0}
    bearing = AppliedEffect("off_axis_compliance", {"joint": "joint_3"}, "before", size)
    assert recorded.wrench is not None
    model = nominal_parameters(cell)
    bent, rigid = (predict_readings(recorded, cell, model.replace(effects=effects)) for effects in ((bearing,), ()))
    askew = recorded.wrench * [1.0, 1.03, 1.0, 1.0, 1.0, 1.0]
    real = dataclasses.replace(recorded, position=recorded.position + bent - rigid, wrench=askew)
    compared = diagnose(real, cell, simulation=simulated(recorded, cell, recorded.wrench)).comparisons[0]
    assert [(one.what, one.wrong) for one in compared.witnesses] == [("wrench", "recording")]


def test_one_gain_of_everything_cannot_be_told_from_stiffer_joints(
    found: Diagnosis, recorded: Readings, cell: Cell
) -> None:
    assert recorded.wrench is not None
    larger = dataclasses.replace(recorded, wrench=1.1 * recorded.wrench)
    (one,) = judged(found, larger, simulated(recorded, cell, recorded.wrench), cell).witnesses
    assert one.wrong == "either"
    assert "stays open" in one.text


def test_the_noise_of_a_sensor_is_no_witness(found: Diagnosis, recorded: Readings, cell: Cell) -> None:
    assert recorded.wrench is not None
    true = simulated(recorded, cell, recorded.wrench)
    assert judged(found, recorded, true, cell).witnesses == ()


def test_angles_of_another_drive_are_judged(found: Diagnosis, recorded: Readings, cell: Cell) -> None:
    assert recorded.wrench is not None
    rng = np.random.default_rng(5)
    off = 1e-3 * rng.standard_normal((recorded.configuration.max() + 1, 6))[recorded.configuration]
    true = simulated(recorded, cell, recorded.wrench)
    elsewhere = dataclasses.replace(recorded, q=recorded.q + off)
    for real, other, wrong in (
        (elsewhere, true, "recording"),
        (recorded, simulated(elsewhere, cell, recorded.wrench), "simulation"),
    ):
        (one,) = judged(found, real, other, cell).witnesses
        assert (one.what, one.wrong) == ("joint angles", wrong)


def test_physics_is_found_with_the_angles_that_the_positions_confirm(recorded: Readings, cell: Cell) -> None:
    """An encoder that errs from step to step looks like friction, as long as its angles are believed."""
    assert recorded.wrench is not None
    steps = np.unique(np.column_stack([recorded.configuration, recorded.step]), axis=0, return_inverse=True)[1]
    angles = recorded.q.copy()
    angles[:, 2] += 2e-4 * np.random.default_rng(2).standard_normal(steps.max() + 1)[steps.reshape(-1)]
    doubtful = dataclasses.replace(recorded, q=angles)
    found = diagnose(doubtful, cell, simulation=simulated(recorded, cell, recorded.wrench))
    (compared,) = found.comparisons
    (one,) = compared.witnesses
    assert (one.what, one.wrong) == ("joint angles", "recording")
    assert one.text in compared.sentences
    assert found.findings == ()
    assert compared.waterfall[-1].rms < 1.2 * found.noise_known


def test_other_times_are_said_and_not_judged(found: Diagnosis, recorded: Readings, cell: Cell) -> None:
    assert recorded.wrench is not None
    true = simulated(recorded, cell, recorded.wrench)
    other = dataclasses.replace(true, temperature=true.temperature + 5.0, time=2 * true.time)
    heard = judged(found, recorded, other, cell).witnesses
    assert [(one.what, one.wrong, one.left) for one in heard] == [
        ("temperature", "either", None),
        ("time", "either", None),
    ]
