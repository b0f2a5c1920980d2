"""Readings: what was solved, seen through instruments, reported as the cell file says."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import CellError
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.sensors import ForceTorqueFaults, Sensors, TrackerFaults
from calibration_sim.cell.table import build_mechanism, measure, simulate_readings, solve
from calibration_sim.cell.truth import WORKSHOP, draw_truth, nominal_truth

Changed = Callable[..., Cell]


def _seen(cell: Cell, sensors: Sensors | None = None, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    truth = draw_truth(cell, 0) if sensors is None else draw_truth(cell, 0, sensors=sensors)
    readings = simulate_readings(cell, truth, random_protocol(cell, 4, 0), seed)
    assert readings.wrench is not None
    return readings.position, readings.wrench


def test_rows_follow_configuration_step_and_point(demo: Cell) -> None:
    protocol = random_protocol(demo, 4, 0)
    readings = simulate_readings(demo, draw_truth(demo, 0), protocol, 1)
    assert len(readings) == 4 * 9 * 3
    assert readings.points == ("mp1", "mp2", "mp3")
    assert readings.configuration.tolist() == np.repeat([1, 2, 3, 4], 27).tolist()
    assert readings.step.tolist() == np.tile(np.repeat(np.arange(9), 3), 4).tolist()
    assert readings.point.tolist() == np.tile([0, 1, 2], 36).tolist()
    assert np.all(np.diff(readings.time) >= 0.0)
    for configuration in protocol.configurations:
        assert np.all(readings.q[readings.configuration == configuration.number] == configuration.q)
    assert readings.temperature == pytest.approx(np.full(108, 20.0), abs=1.0)


def test_seeds_reproduce_and_noise_seeds_share_a_solution(demo: Cell) -> None:
    solved = solve(demo, draw_truth(demo, 0), random_protocol(demo, 4, 0))
    first, again, other = (measure(solved, demo, seed) for seed in (5, 5, 6))
    assert np.array_equal(first.position, again.position)
    assert first.wrench is not None
    assert again.wrench is not None
    assert np.array_equal(first.wrench, again.wrench)
    assert not np.any(np.all(first.position == other.position, axis=1))
    whole = simulate_readings(demo, draw_truth(demo, 0), random_protocol(demo, 4, 0), 5)
    assert np.array_equal(first.position, whole.position)


def test_mean_over_seeds_is_the_truth_and_scatter_the_claim(demo: Cell) -> None:
    solved = solve(demo, draw_truth(demo, 0), random_protocol(demo, 2, 0))
    readings = [measure(solved, demo, seed) for seed in range(400)]
    position = np.array([r.position for r in readings])
    wrench = np.array([r.wrench for r in readings])
    assert position.mean(axis=0) == pytest.approx(solved.states.points.reshape(-1, 3), abs=5e-6)
    assert position.std(axis=0).mean() == pytest.approx(2e-5, rel=0.02)
    assert wrench.mean(axis=0) == pytest.approx(np.repeat(solved.states.wrench, 3, axis=0), abs=0.3)
    assert wrench.std(axis=0).mean(axis=0) == pytest.approx([1, 1, 1, 0.5, 0.5, 0.5], rel=0.03)
    assert np.array([r.temperature for r in readings]).std() == pytest.approx(0.1, rel=0.05)


def test_points_stay_rigid_and_stand_where_the_flange_is(demo: Cell) -> None:
    """Distances between points never change, and the tracker frame leads back to the base."""
    truth = draw_truth(demo, 3, spread=WORKSHOP)
    solved = solve(demo, truth, random_protocol(demo, 5, 3))
    nominal = np.array(list(truth.points.values()))
    for points in solved.states.points:
        for a, b in ((0, 1), (0, 2), (1, 2)):
            seen = np.linalg.norm(points[a] - points[b])
            assert seen == pytest.approx(np.linalg.norm(nominal[a] - nominal[b]), abs=1e-12)
    rest = build_mechanism(demo, truth).equilibrium(solved.states.q[0])
    assert truth.tracker.apply(solved.states.points[0]) == pytest.approx(rest.flange.apply(nominal), abs=1e-12)


def test_load_pulls_along_its_direction(demo: Cell) -> None:
    """A force does positive work on the wrench point; here the points follow it within a right angle."""
    protocol = random_protocol(demo, 12, 1)
    solved = solve(demo, nominal_truth(demo), protocol)
    points = solved.states.points.reshape(12, 9, 3, 3) @ nominal_truth(demo).tracker.rotation.T
    for i, configuration in enumerate(protocol.configurations):
        shift = (points[i, 4] - points[i, 0]).mean(axis=0)
        assert shift @ configuration.wrenches[4, :3] > 0.0
        assert points[i, 8] == pytest.approx(points[i, 0], abs=1e-12)
        assert points[i, 2] == pytest.approx(points[i, 6], abs=1e-12)
        half = (points[i, 2] - points[i, 0]) / (points[i, 4] - points[i, 0])
        assert np.median(half) == pytest.approx(0.5, abs=0.02)


def test_the_sensor_reports_in_its_own_deformed_axes(demo: Cell, changed: Changed) -> None:
    """Base axes at the wrench point give the pull itself; the sensor's report leads back to it."""
    protocol = random_protocol(demo, 3, 0)
    truth = draw_truth(demo, 0, spread=WORKSHOP)
    pulls = np.concatenate([configuration.wrenches for configuration in protocol.configurations])
    plain = changed(demo, measurements={"wrench_axes": "base", "wrench_at": "wrench_point"})
    assert solve(plain, truth, protocol).states.wrench == pytest.approx(pulls)
    solved = solve(demo, truth, protocol)
    mechanism = build_mechanism(demo, truth)
    for i, (q, pull) in enumerate(zip(solved.states.q, pulls, strict=True)):
        flange = mechanism.equilibrium(q, pull).flange
        sensor = flange @ truth.force_torque
        force, torque = (sensor.rotation @ part for part in np.split(solved.states.wrench[i], 2))
        arm = flange.apply(truth.wrench_point) - sensor.translation
        assert force == pytest.approx(pull[:3], abs=1e-9)
        assert torque - np.cross(arm, force) == pytest.approx(pull[3:], abs=1e-9)
    half = changed(demo, measurements={"wrench_axes": "base", "wrench_at": "sensor"})
    assert solve(half, truth, protocol).states.wrench[:, :3] == pytest.approx(pulls[:, :3])


def test_an_unloaded_tared_sensor_reads_nothing(demo: Cell) -> None:
    solved = solve(demo, draw_truth(demo, 0), random_protocol(demo, 3, 0))
    assert not solved.states.wrench[solved.step == 0].any()


def test_sensor_faults_arrive_in_the_readings(demo: Cell) -> None:
    position, wrench = _seen(demo)
    bias = (1e-3, -2e-3, 0.5e-3)
    shifted, _ = _seen(demo, Sensors(tracker=TrackerFaults(bias=bias)))
    assert shifted - position == pytest.approx(np.tile(bias, (len(position), 1)), abs=2e-7)
    loud, _ = _seen(demo, Sensors(tracker=TrackerFaults(noise_factor=10.0)))
    solved = solve(demo, draw_truth(demo, 0), random_protocol(demo, 4, 0)).states.points.reshape(-1, 3)
    assert loud - solved == pytest.approx(10.0 * (position - solved), abs=1e-6)
    wild, _ = _seen(demo, Sensors(tracker=TrackerFaults(outlier_rate=0.2)))
    assert np.median(np.abs(wild - solved)) < 3e-5
    assert np.max(np.abs(wild - solved)) > 3e-4
    _, offset = _seen(demo, Sensors(force_torque=ForceTorqueFaults(bias=(5, 0, 0, 0, -1, 0))))
    assert offset - wrench == pytest.approx(np.tile([5, 0, 0, 0, -1, 0], (len(wrench), 1)), abs=0.11)


def test_points_read_at_once_share_a_wrench_and_points_read_in_turn_do_not(demo: Cell) -> None:
    _, together = _seen(demo)
    _, apart = _seen(demo, Sensors(one_after_another=True))
    assert np.all(np.ptp(together.reshape(-1, 3, 6), axis=1) == 0.0)
    assert np.all(np.ptp(apart.reshape(-1, 3, 6), axis=1).any(axis=1))
    truth = dataclasses.replace(draw_truth(demo, 0), sensors=Sensors(one_after_another=True))
    time = simulate_readings(demo, truth, random_protocol(demo, 4, 0), 0).time
    assert np.all(np.diff(time) > 0.0)


def test_displacements_are_differences_to_step_zero(demo: Cell, changed: Changed) -> None:
    cell = changed(demo, measurements={"points": "displacement"})
    protocol, truth = random_protocol(demo, 3, 0), draw_truth(demo, 0)
    absolute = simulate_readings(demo, truth, protocol, 4).position.reshape(3, 9, 3, 3)
    relative = simulate_readings(cell, truth, protocol, 4).position.reshape(3, 9, 3, 3)
    assert relative == pytest.approx(absolute - absolute[:, :1], abs=1e-15)


def test_a_cell_without_load_is_recorded_without_wrench(demo: Cell, changed: Changed) -> None:
    bare = changed(
        demo,
        frames__wrench_point=None,
        frames__force_torque=None,
        instruments__force_torque=None,
        instruments__temperature=None,
    )
    protocol = random_protocol(bare, 5, 0)
    assert protocol.steps == 5
    readings = simulate_readings(bare, nominal_truth(bare), protocol, 0)
    assert readings.wrench is None
    assert np.all(np.isnan(readings.temperature))
    with pytest.raises(CellError, match="wrench_point"):
        solve(bare, nominal_truth(bare), random_protocol(demo, 2, 0))


def test_a_sensor_without_a_place_is_refused(demo: Cell, changed: Changed) -> None:
    lost = changed(demo, frames__force_torque=None)
    with pytest.raises(CellError, match="force_torque"):
        solve(lost, nominal_truth(lost), random_protocol(demo, 2, 0))
