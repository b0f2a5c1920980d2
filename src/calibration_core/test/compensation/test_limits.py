"""How far answers go: speeds, loads, units; one rule for deflections and compensations."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from calibration_core.cell import Cell
from calibration_core.compensation.compensate import compensate
from calibration_core.compensation.requests import corrected_rates
from calibration_core.compensation.robot import CalibratedRobot
from calibration_core.compensation.task import places, read_task
from calibration_core.errors import InputError, TaskError
from calibration_core.model.identified.calibrated import CalibratedModel, ValidRange
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.motion.speed import SAFETY_RATED_SPEED, Monitored
from calibration_core.outcomes.compensation import apply, deflected

GOOD = [0.0, 0.1, 0.1, 0.2, 0.8, 0.3]


def model_of(cell: Cell) -> ModelParameters:
    """Return a model whose geometry is half a millimetre and half a milliradian off."""
    return nominal_parameters(cell).replace(geometry=np.random.default_rng(4).normal(0, 5e-4, (6, 6)))


def test_angles_in_degrees_are_refused_and_a_joint_beyond_its_limits_is_a_row(cell: Cell, tmp_path: Path) -> None:
    model = model_of(cell)
    robot, calibrated = CalibratedRobot.of(cell, model), CalibratedModel(model, None, None)
    path = tmp_path / "task.csv"
    angles, good = "q1,q2,q3,q4,q5,q6", ",".join(map(str, GOOD))
    for text, place, found in (
        (f"{angles}\n{good}\n10,20,30,40,50,60\n", "line 3", "joint_"),
        (f"{angles},x,y,z,roll,pitch,yaw\n0,90,0,0,45,0,1,0,1,0,0,0\n", "line 2", "joint_2 at 90"),
        (f"{angles},x,y,z,roll,pitch,yaw\n{good},1,0,1,0,90,0\n", "line 2", "pitch = 90"),
    ):
        path.write_text(text)
        task = read_task(path, cell)
        for use in (
            lambda task: apply(robot, calibrated, task),
            lambda task: deflected(robot, calibrated, task.with_wrench([1.0] * 6), axes="base", plane=None),
        ):
            with pytest.raises(TaskError) as caught:
                use(task)
            assert (caught.value.file, caught.value.place) == (str(path), place)
            assert found in caught.value.found
            assert "degrees?" in caught.value.expected
    with pytest.raises(InputError, match="seed_q: found joint_1 at 90"):
        apply(robot, calibrated, places(q=np.array([GOOD])), seed_q=np.full(6, 90.0))


def test_one_rule_of_loads_for_deflections_and_compensations(cell: Cell) -> None:
    """Beyond the rated load nothing is answered, beyond the measured load the row is named; a payload counts."""
    model = model_of(cell)
    covered = ValidRange(np.tile([-7.0, 7.0], (6, 1)), (0.0, 500.0), (0.0, 10.0), None)
    calibrated = CalibratedModel(model, None, covered)
    rated = 9.80665 * cell.robot.rated_load
    q = np.array([GOOD])
    for force, torque, payload, answered, outside in (
        (499.0, 9.0, 0.0, True, {}),
        (499.0, 9.0, 10.0, True, {"load": [1]}),
        (501.0, 0.0, 0.0, True, {"load": [1]}),
        (1.0, 11.0, 0.0, True, {"load": [1]}),
        (rated + 1, 0.0, 0.0, False, {"load": [1]}),
        (1.0, 0.0, cell.robot.rated_load, False, {"load": [1]}),
    ):
        robot = CalibratedRobot.of(cell, model, (payload, 0.0, 0.0, 0.0))
        task = places(q=q, wrench=np.array([[0.0, 0.0, -force, torque, 0.0, 0.0]]))
        applied = apply(robot, calibrated, task)
        assert applied.found.status == ("ok" if answered else "load beyond the rated load",)
        assert applied.outside == outside
        if answered:
            assert deflected(robot, calibrated, task, axes="base", plane=None).outside == outside
        else:
            with pytest.raises(
                InputError, match=r"row 1: found load beyond the rated load, expected at most [0-9.]+ N"
            ):
                deflected(robot, calibrated, task, axes="base", plane=None)


def test_times_that_some_rows_lack_are_not_used_and_it_is_said(cell: Cell) -> None:
    model = model_of(cell)
    robot, calibrated = CalibratedRobot.of(cell, model), CalibratedModel(model, None, None)
    q = np.array([GOOD, GOOD, [0.2, *GOOD[1:]]])
    for time, said in (([0.0, 9.0, 18.0], False), ([np.nan] * 3, False), ([0.0, np.nan, 18.0], True)):
        applied = apply(robot, calibrated, dataclasses.replace(places(q=q), time=np.array(time)))
        assert any("Some rows have no time" in one for one in applied.remarks) is said
        assert bool(applied.time[-1] == 18.0) is (time[1] == 9.0)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(2, 6),
    seconds=st.floats(0.05, 5.0),
    rates=st.booleans(),
)
def test_what_is_answered_with_times_is_never_too_fast(
    cell: Cell, seed: int, rows: int, seconds: float, rates: bool
) -> None:
    """Every interpolation of an accepted trajectory, sampled finely, keeps all points of the robot below 250 mm/s."""
    rng = np.random.default_rng(seed)
    q = np.array(GOOD) + np.cumsum(rng.normal(0, 0.02, (rows, 6)), axis=0)
    force = np.hstack([rng.normal(0, 300, (rows, 3)), np.zeros((rows, 3))])
    task = dataclasses.replace(places(q=q, wrench=force, one_path=True), time=np.arange(rows) * seconds)
    if rates:
        task = dataclasses.replace(task, rate=rng.normal(0, 0.05, (rows, 6)))
    model = model_of(cell)
    robot = CalibratedRobot.of(cell, model)
    monitored = Monitored.of(robot.chain, model, robot.tool[:3, 3])
    assert "tool" in monitored.names
    corrected = compensate(robot, task, None)
    rate = None if task.rate is None else corrected_rates(corrected.nominal, corrected.q, task.time, task.rate)
    speed = 0.0
    for k in range(rows - 1):
        ends = [np.diff(corrected.q[k : k + 2], axis=0) / seconds] * 2
        for first, last in [ends] if rate is None else [ends, (rate[[k]], rate[[k + 1]])]:
            curve = CubicHermiteSpline([0.0, seconds], corrected.q[k : k + 2], np.vstack([first, last]))
            at = np.linspace(0.0, seconds, 300)
            speed = max(speed, float(monitored.speeds(curve(at), curve(at, 1)).max()))
    calibrated = CalibratedModel(model, None, None)
    if speed > SAFETY_RATED_SPEED:
        with pytest.raises(TaskError, match="mm/s on the way there"):
            apply(robot, calibrated, task)
    elif speed < 0.24:  # the bound is close
        np.testing.assert_array_equal(apply(robot, calibrated, task).time, task.time)
