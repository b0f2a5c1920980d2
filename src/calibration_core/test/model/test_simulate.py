"""The model's own readings: consistent with its equilibrium, with noise of the claimed size, the same as streams."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import CellError
from calibration_core.model.chain import rotation_rpy
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import Schedule, as_recording, simulate_plan, tracker_covariance
from calibration_core.timeseries import Phase, Readings

CELLS = Path(__file__).parents[4] / "config" / "cells"
LEVELS = (0.0, 0.5, 1.0, 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Pull:
    """A configuration with an oblique pull."""

    number: int
    q: np.ndarray
    steps: np.ndarray


def _pulls(count: int, force: float = 2000.0) -> list[Pull]:
    rng = np.random.default_rng(4)
    steps = [np.outer(LEVELS, np.r_[rng.normal(0, 0.5, 2), -1, 0, 0, 0]) * force for _ in range(count)]
    middle = np.array([0.0, 0.3, -0.8, 0.2, 0.9, 0.1])
    return [Pull(10 + i, middle + rng.uniform(-0.4, 0.4, 6), step) for i, step in enumerate(steps)]


@pytest.fixture(scope="module", params=["demo", "small"])
def cell(request: pytest.FixtureRequest) -> Cell:
    return load_cell(CELLS / f"{request.param}.cell.yaml")


def _force(cell: Cell) -> float:
    return 9.0 * cell.robot.rated_load


def _with(cell: Cell, **changes: str) -> Cell:
    return cell.model_copy(update={"measurements": cell.measurements.model_copy(update=changes)})


def test_rows_and_conventions(cell: Cell) -> None:
    parameters = nominal_parameters(cell)
    readings = simulate_plan(_pulls(3, _force(cell)), cell, parameters)
    assert len(readings) == 3 * len(LEVELS) * 3
    assert readings.configuration.tolist() == np.repeat([10, 11, 12], 12).tolist()
    assert readings.step[:12].tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert np.array_equal(readings.position[:3], readings.position[9:12])  # the model has no memory
    size = np.linalg.norm(readings.wrench[:, :3], axis=1)
    expected = np.repeat([np.linalg.norm(pull.steps[:, :3], axis=1) for pull in _pulls(3, _force(cell))], 3)
    np.testing.assert_allclose(size, expected, rtol=1e-12)  # a rotation keeps the size


def test_rigid_robot_is_its_kinematics(cell: Cell) -> None:
    """Stiff springs: points are where forward kinematics has them, and the wrench balances about any point."""
    nominal = nominal_parameters(cell)
    rigid = nominal.replace(compliance=np.zeros(6))
    pulls = _pulls(2, _force(cell))
    readings = simulate_plan(pulls, cell, rigid)
    at = posture(chain_of(cell), readings.q)
    rotation, origin = nominal.tracker[:3, :3], nominal.tracker[:3, 3]
    points = np.stack([at.point(point).T for point in nominal.points.values()])[
        readings.point, np.arange(len(readings))
    ]
    np.testing.assert_allclose(readings.position @ rotation.T + origin, points, atol=1e-12)
    flange = np.moveaxis(at.flange, -1, 0).transpose(0, 2, 1)  # (m, 3, 3), base from flange
    axes = flange @ nominal.force_torque[:3, :3]
    force = np.einsum("mij,mj->mi", axes, readings.wrench[:, :3])
    torque = np.einsum("mij,mj->mi", axes, readings.wrench[:, 3:])
    arm = (at.point(nominal.force_torque[:3, 3]) - at.point(nominal.wrench_point)).T
    wanted = np.concatenate([np.repeat(pull.steps, 3, axis=0) for pull in pulls])
    np.testing.assert_allclose(force, wanted[:, :3], atol=1e-9)
    np.testing.assert_allclose(torque + np.cross(arm, force), wanted[:, 3:], atol=1e-9)
    in_base = simulate_plan(pulls, _with(cell, wrench_axes="base", wrench_at="wrench_point"), rigid)
    np.testing.assert_allclose(in_base.wrench, wanted, atol=1e-12)


def test_deflections_are_the_standard_equation(cell: Cell) -> None:
    """Small loads: J_MP K^-1 J_WP^T W, by finite differences of the kinematics alone."""
    parameters, chain = nominal_parameters(cell), chain_of(cell)
    pulls = _pulls(2, 1e-3 * _force(cell))
    weightless = dataclasses.replace(chain, mass=None, com=None)
    readings = simulate_plan(pulls, _with(cell, points="displacement"), parameters)

    def jacobian(q: np.ndarray, point: np.ndarray) -> np.ndarray:
        steps = np.eye(6) * 1e-6
        high, low = posture(weightless, q + steps).point(point), posture(weightless, q - steps).point(point)
        return (high - low) / 2e-6

    for pull in pulls:
        torque = jacobian(pull.q, parameters.wrench_point).T @ pull.steps[2, :3]
        for i, point in enumerate(parameters.points.values()):
            expected = jacobian(pull.q, point) @ (parameters.compliance * torque)
            row = (readings.configuration == pull.number) & (readings.step == 2) & (readings.point == i)
            seen = parameters.tracker[:3, :3] @ readings.position[row][0]
            # gravity and K_CSM change the answer by some per mille
            assert np.linalg.norm(seen - expected) < 0.02 * np.linalg.norm(expected)


def test_noise_has_the_claimed_covariance(cell: Cell) -> None:
    parameters, pulls = nominal_parameters(cell), _pulls(40, _force(cell))
    clean = simulate_plan(pulls, cell, parameters)
    errors, wrench = [], []
    for seed in range(20):
        noisy = simulate_plan(pulls, cell, parameters, seed)
        errors.append(noisy.position - clean.position)
        wrench.append(noisy.wrench - clean.wrench)
        assert np.array_equal(noisy.wrench[0], noisy.wrench[2])  # one wrench reading for the points of a step
    root = np.linalg.cholesky(tracker_covariance(cell, clean.position))
    white = np.linalg.solve(root, np.stack(errors)[..., None])[..., 0].reshape(-1, 3)
    np.testing.assert_allclose(np.cov(white.T), np.eye(3), atol=0.05)
    sigma = cell.instruments.force_torque
    np.testing.assert_allclose(
        np.concatenate(wrench).std(axis=0)[[0, 3]], [sigma.sigma_force, sigma.sigma_torque], rtol=0.05
    )
    again = simulate_plan(pulls, cell, parameters, 3)
    assert np.array_equal(again.position, simulate_plan(pulls, cell, parameters, 3).position)


def test_spherical_noise(cell: Cell) -> None:
    position = np.random.default_rng(0).normal(0, 3, (5, 3))
    covariance = tracker_covariance(cell, position)
    tracker = cell.instruments.tracker
    distance = np.linalg.norm(position, axis=1)
    along = np.einsum("mi,mij,mj->m", position, covariance, position) / distance**2
    if tracker.sigma is not None:
        np.testing.assert_allclose(along, tracker.sigma**2)
    else:
        np.testing.assert_allclose(along, (tracker.sigma_range + tracker.sigma_range_per_m * distance) ** 2)
        up = np.cross(position, np.cross([0.0, 0.0, 1.0], position))
        up /= np.linalg.norm(up, axis=1)[:, None]
        by_elevation = np.einsum("mi,mij,mj->m", up, covariance, up)
        np.testing.assert_allclose(by_elevation, (tracker.sigma_angle * distance) ** 2)


def _window_means(cell: Cell, parameters: ModelParameters, seed: int | None) -> tuple[Readings, dict[str, np.ndarray]]:
    pulls = _pulls(3, _force(cell))
    recording = as_recording(pulls, cell, parameters, seed)
    steps = recording.steps
    measuring = np.flatnonzero(steps.phase == Phase.MEASURING)
    windows = [(steps.time[i], steps.time[i + 1]) for i in measuring]

    def means(series) -> np.ndarray:
        return np.array([series.values[(series.time >= a) & (series.time < b)].mean(axis=0) for a, b in windows])

    found = {name: means(series) for name, series in recording.points.items()}
    found |= {
        "q": means(recording.joints),
        "wrench": means(recording.wrench),
        "temperature": means(recording.temperature),
    }
    return simulate_plan(pulls, cell, parameters, seed), found


@pytest.mark.parametrize("seed", [None, 5])
def test_streams_hold_the_same_readings(cell: Cell, seed: int | None) -> None:
    readings, means = _window_means(cell, nominal_parameters(cell), seed)
    for i, name in enumerate(readings.points):
        np.testing.assert_allclose(means[name], readings.position[readings.point == i], atol=1e-12)
    first = readings.point == 0
    np.testing.assert_allclose(means["q"], readings.q[first], atol=1e-12)
    np.testing.assert_allclose(means["wrench"], readings.wrench[first], atol=1e-9)
    np.testing.assert_allclose(means["temperature"][:, 0], readings.temperature[first], atol=1e-9)


def test_streams_scatter_as_claimed(cell: Cell) -> None:
    """The scatter within a window promises the error of its mean."""
    parameters = nominal_parameters(cell)
    recording = as_recording(_pulls(20, _force(cell)), cell, parameters, 1)
    steps, series = recording.steps, recording.wrench
    variance = []
    for i in np.flatnonzero(steps.phase == Phase.MEASURING):
        rows = (series.time >= steps.time[i]) & (series.time < steps.time[i + 1])
        variance.append(series.values[rows].var(axis=0, ddof=1) / rows.sum())
    claim = cell.instruments.force_torque
    np.testing.assert_allclose(
        np.sqrt(np.mean(variance, axis=0)), np.repeat([claim.sigma_force, claim.sigma_torque], 3), rtol=0.1
    )


def test_recording_is_well_formed(cell: Cell) -> None:
    recording = as_recording(_pulls(2, _force(cell)), cell, nominal_parameters(cell))
    steps = recording.steps
    assert np.all(np.diff(steps.time) > 0)
    assert set(steps.phase.tolist()) == {int(phase) for phase in Phase}
    jump = np.abs(np.diff(recording.joints.values, axis=0)).max()
    assert jump < 0.02  # joints do not jump
    assert recording.provenance.messages[cell.topics.step] == len(steps.time)
    assert bool(recording.robot_description) == (cell.urdf_path is not None)


def test_what_cannot_be_simulated_is_said(cell: Cell) -> None:
    parameters, pulls = nominal_parameters(cell), _pulls(1)
    with pytest.raises(CellError, match="absolute"):
        as_recording(pulls, _with(cell, points="displacement"), parameters)
    with pytest.raises(CellError, match="wrench_point"):
        simulate_plan(pulls, cell, parameters.replace(wrench_point=None))
    with pytest.raises(CellError, match="force_torque"):
        simulate_plan(pulls, cell, parameters.replace(force_torque=None))
    with pytest.raises(ValueError, match="unequal"):
        Schedule(np.zeros(2), np.zeros(2), np.zeros((2, 6)), np.zeros((3, 6)))


def test_corrected_geometry_is_used(cell: Cell) -> None:
    geometry = np.zeros((6, 6))
    geometry[2, 0] = 1e-3
    turned = np.eye(4)
    turned[:3, :3] = rotation_rpy(0.1, 0.2, 0.3)
    parameters = nominal_parameters(cell).replace(tracker=turned, compliance=np.zeros(6))
    pulls = _pulls(1, _force(cell))
    moved = (
        simulate_plan(pulls, cell, parameters.replace(geometry=geometry)).position
        - simulate_plan(pulls, cell, parameters).position
    )
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1e-3, rtol=1e-9)


@pytest.mark.parametrize("seed", [None, 5])
def test_bag_is_read_back_as_the_same_readings(cell: Cell, seed: int | None, tmp_path: Path) -> None:
    from calibration_core.observations.observe import observe
    from calibration_core.recording.bags.writer import write_bag

    parameters, pulls = nominal_parameters(cell), _pulls(4, _force(cell))
    write_bag(tmp_path / "bag", as_recording(pulls, cell, parameters, seed), cell)
    seen, wanted = observe(tmp_path / "bag", cell), simulate_plan(pulls, cell, parameters, seed)
    assert seen.points == wanted.points
    for field in ("configuration", "step", "point"):
        assert np.array_equal(getattr(seen, field), getattr(wanted, field))
    np.testing.assert_allclose(seen.q, wanted.q, atol=1e-9)
    # where the observer leaves out the beginning of a window, the mean moves by a part of its own error
    sigma = np.sqrt(tracker_covariance(cell, wanted.position).trace(axis1=1, axis2=2) / 3)
    tolerance = 1e-9 if seed is None else 2.5 * sigma.max()
    np.testing.assert_allclose(seen.position, wanted.position, atol=tolerance)
    assert seen.position_covariance is not None
