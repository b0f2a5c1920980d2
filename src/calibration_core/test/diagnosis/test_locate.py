"""The location without a hypothesis: what is planted is placed, and noise follows nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robots import loaded_readings

from calibration_core.cell import Cell
from calibration_core.diagnosis.location import CERTAIN, Located, locate
from calibration_core.model.effects.joint_law.hysteresis import stop
from calibration_core.model.kinematics import cross, posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of, load_torque
from calibration_core.timeseries import Float1D, Float2D, Readings

NOISE = 2e-5


@pytest.fixture(scope="module")
def readings(cell: Cell) -> Readings:
    return loaded_readings(cell, 7, 18)


def turned(readings: Readings, cell: Cell, joint: int, axis: int, angle: Float1D) -> Float2D:
    """Return (m, 3) m: everything beyond a joint turned about an axis (0, 1, 2) of the frame before it."""
    at = posture(chain_of(cell), readings.q)
    stated = nominal_parameters(cell).points
    points = np.stack([stated[name] for name in readings.points])[readings.point].T
    return np.asarray((cross(at.before[joint][axis], at.point(points) - at.origin[joint]) * angle).T)


def torque(readings: Readings, cell: Cell, joint: int) -> Float1D:
    return np.asarray(
        load_torque(posture(chain_of(cell), readings.q), load_of(readings, cell, nominal_parameters(cell)))[joint]
    )


def located(readings: Readings, residual: Float2D, cell: Cell, seed: int = 0) -> Located:
    noise = NOISE * np.random.default_rng(seed).standard_normal(residual.shape)
    found = locate(readings, residual + noise, cell, nominal_parameters(cell))
    assert found is not None
    return found


@pytest.mark.parametrize(("joint", "axis"), [(1, 0), (2, 1), (4, 0)])
def test_a_joint_that_tilts_is_the_one_whose_lines_are_met(
    cell: Cell, readings: Readings, joint: int, axis: int
) -> None:
    angle = 4e-4 / np.abs(torque(readings, cell, joint)).max() * torque(readings, cell, joint)
    found = located(readings, turned(readings, cell, joint, axis, angle), cell)
    best = found.shares[0].joint
    assert best in ({"joint_5", "joint_6"} if joint == 4 else {f"joint_{joint + 1}"})  # they share their origin
    assert found.shares[0].any_axis > 0.7
    own = next(share for share in found.shares if share.joint == f"joint_{joint + 1}").own_axis
    assert own < 0.3
    assert best in " ".join(found.sentences)


def test_turns_about_its_own_axis_are_told_from_others(cell: Cell, readings: Readings) -> None:
    found = located(readings, turned(readings, cell, 2, 2, 1e-7 * torque(readings, cell, 2)), cell)
    assert max(found.shares, key=lambda share: share.own_axis).joint in {"joint_2", "joint_3"}  # parallel axes
    assert next(share for share in found.shares if share.joint == "joint_3").own_axis > 0.6


def test_no_quantity_is_followed_by_more_than_the_whole(cell: Cell, readings: Readings) -> None:
    """What stands still in base axes turns with the flange: it varies there alone."""
    found = located(readings, (readings.step == 2)[:, None] * np.array([1e-3, 0.0, 0.0]), cell)
    assert 0.05 < max(one.share for one in found.dependences) <= 1.0


def test_turn_and_shift_are_measured(cell: Cell, readings: Readings) -> None:
    full = readings.step == 2
    found = located(readings, full[:, None] * np.array([1e-4, 0.0, 0.0]), cell)
    assert found.shift == pytest.approx(1e-4, rel=0.1)
    assert found.turn < 3e-4
    assert found.rms == pytest.approx(1e-4 / np.sqrt(3), rel=0.15)


def test_memory_shows_in_the_branches(cell: Cell, readings: Readings) -> None:
    plain = located(readings, np.zeros((len(readings), 3)), cell)
    assert plain.memory_chance > CERTAIN
    tau = torque(readings, cell, 1)
    angle = np.zeros(len(readings))
    for c in np.unique(readings.configuration):
        for p in range(3):
            rows = (readings.configuration == c) & (readings.point == p)
            series = tau[rows][None]
            angle[rows] = -2e-4 * stop(series, 0.1 * np.abs(tau).max(), 0.0)[0] / (0.1 * np.abs(tau).max())
    found = located(readings, turned(readings, cell, 1, 2, angle), cell)
    assert found.memory_chance < CERTAIN
    assert found.memory > 5 * plain.memory
    assert any("remembers" in sentence for sentence in found.sentences)


def test_how_it_grows_with_the_load_is_said(cell: Cell, readings: Readings) -> None:
    tau = torque(readings, cell, 1)
    linear = located(readings, turned(readings, cell, 1, 0, 2e-8 * tau), cell)
    assert [round(level.level, 1) for level in linear.levels] == [0.0, 0.5, 1.0, 0.5, 0.0]
    assert linear.levels[1].along == pytest.approx(linear.levels[2].along / 2, rel=0.2)
    assert any("in proportion" in sentence for sentence in linear.sentences)
    flat = located(readings, turned(readings, cell, 1, 0, 2e-4 * np.sign(np.round(tau, -1))), cell)
    assert any("faster at small loads" in sentence for sentence in flat.sentences)


def test_noise_follows_nothing(cell: Cell, readings: Readings) -> None:
    zero = np.zeros((len(readings), 3))
    chances = [located(readings, zero, cell, seed).dependences[0].chance for seed in range(30)]
    assert sum(chance < CERTAIN for chance in chances) <= 2


def test_of_noise_no_law_and_no_joint_is_said(cell: Cell, readings: Readings) -> None:
    found = located(readings, np.zeros((len(readings), 3)), cell)
    said = " ".join(found.sentences)
    assert "lines of no joint" in said
    assert "no law of the load" in said
    assert "It grows" not in said


def test_a_reference_measured_again_and_again_hides_nothing(cell: Cell, readings: Readings) -> None:
    first = np.flatnonzero(readings.configuration == readings.configuration[0])
    longer = readings.select(np.concatenate([np.arange(len(readings)), first, first]))
    step, configuration = longer.step.copy(), longer.configuration.copy()
    step[-len(first) :] += step.max() + 1
    configuration[len(readings) :] = 0
    assert readings.configuration.min() > 0
    longer = dataclasses.replace(longer, step=step, configuration=configuration)
    noise = NOISE * np.random.default_rng(3).standard_normal((len(longer), 3))
    model = nominal_parameters(cell)
    found = locate(longer, noise, cell, model)
    alone = locate(readings, noise[: len(readings)], cell, model)
    assert found is not None
    assert repr(found) == repr(alone)


def test_joints_that_explain_as_much_are_named_together(cell: Cell, readings: Readings) -> None:
    found = located(readings, turned(readings, cell, 4, 0, 4e-6 * torque(readings, cell, 4)), cell)
    assert "joint_5 (" in " ".join(found.sentences)
    assert "joint_6 (" in " ".join(found.sentences)  # they share their origin


def test_drift_of_absolute_positions_follows_the_time(cell: Cell, readings: Readings) -> None:
    still = readings.select(readings.step == 0)
    still = dataclasses.replace(still, wrench=None)
    drift = still.time[:, None] / still.time.max() * np.array([0.0, 2e-4, 0.0])
    found = located(still, drift - drift.mean(axis=0), cell)
    assert found.dependences[0].on == "the time"
    assert found.dependences[0].chance < CERTAIN
    assert found.levels == ()


def test_too_few_configurations_say_nothing(cell: Cell, readings: Readings) -> None:
    few = readings.select(readings.configuration <= 4)
    assert locate(few, np.zeros((len(few), 3)), cell, nominal_parameters(cell)) is None
