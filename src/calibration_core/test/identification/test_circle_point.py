"""Circles, spheres, base coordinate system, joint axes and wrist centre against known truths."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from robots import write_cell

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.circle_point.circle import _jacobian, _residual, fit_circle, fit_coaxial
from calibration_core.identification.circle_point.joint_axes import identify_axes, single_joint_sweeps
from calibration_core.identification.wrist import fit_sphere, identify_wrist_centre, trilaterate
from calibration_core.model.chain import Chain, rpy_of
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Provenance, Readings

HOME = np.array([0.2, -0.3, 0.4, 0.3, 0.9, -0.2])
SIGMA = 2e-5


def _readings(cell: Cell, chain: Chain, q: np.ndarray, sigma: float, seed: int = 0) -> Readings:
    """Return what the tracker sees of all points at every pose."""
    truth = nominal_parameters(cell)
    names = tuple(truth.points)
    m, k = len(q), len(names)
    at = posture(chain, q)
    seen = np.stack([at.point(truth.points[name]).T for name in names], axis=1).reshape(m * k, 3)
    position = (seen - truth.tracker[:3, 3]) @ truth.tracker[:3, :3]
    noise = np.random.default_rng(seed).normal(0, sigma, position.shape) if sigma else 0.0
    rows = np.repeat(np.arange(m), k)
    return Readings(
        points=names, configuration=rows + 1, step=np.zeros(m * k, dtype=int), point=np.tile(np.arange(k), m),
        q=q[rows], position=position + noise, wrench=None, time=np.arange(m * k, dtype=float),
        temperature=np.full(m * k, np.nan), provenance=Provenance("sweeps.csv", "csv", {}, {}),
    )  # fmt: skip


def _sweeps(joints: range, poses: int = 25, arc: float = 2.4) -> np.ndarray:
    parts = []
    for joint in joints:
        q = np.tile(HOME, (poses, 1))
        q[:, joint] += np.linspace(-arc / 2, arc / 2, poses)
        parts.append(q)
    return np.concatenate(parts)


def test_circle_jacobian_against_finite_differences() -> None:
    rng = np.random.default_rng(1)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points, values = rng.normal(size=(7, 3)), rng.normal(size=6) * 0.3
    arguments = (points, frame[2], frame[0], frame[1])
    exact = _jacobian(values, *arguments)
    for k in range(6):
        h = np.zeros(6)
        h[k] = 1e-7
        numeric = (_residual(values + h, *arguments) - _residual(values - h, *arguments)) / 2e-7
        np.testing.assert_allclose(exact[:, k], numeric, atol=1e-7)


@pytest.mark.parametrize("arc", [1.0, 3.0])
def test_circle_intervals_cover(arc: float) -> None:
    angle = np.linspace(0, arc, 30)
    frame = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    frame[:, 2] *= np.linalg.det(frame)
    truth = np.array([1.0, 2.0, 0.5])
    z = []
    for seed in range(200):
        clean = truth + 1.5 * (np.cos(angle)[:, None] * frame[:, 0] + np.sin(angle)[:, None] * frame[:, 1])
        points = clean + np.random.default_rng(seed).normal(0, SIGMA, clean.shape)
        circle = fit_circle(points)
        assert circle.normal @ frame[:, 2] > 0.999
        alone = fit_coaxial([circle], [points])
        z.append((alone.centres[0] - truth) / np.sqrt(np.diag(alone.line_covariance(0))[:3]))
    assert 0.9 < np.mean(np.abs(z) < 2.0) < 0.98
    assert circle.arc == pytest.approx(arc, rel=1e-3)


def test_sphere_and_trilateration() -> None:
    rng = np.random.default_rng(3)
    truth, errors = np.array([0.3, -0.2, 1.0]), []
    for _ in range(200):
        directions = rng.normal(size=(20, 3))
        points = truth + 0.25 * directions / np.linalg.norm(directions, axis=1)[:, None]
        sphere = fit_sphere(points + rng.normal(0, SIGMA, points.shape))
        errors.append((sphere.centre - truth) / np.sqrt(np.diag(sphere.covariance)[:3]))
    assert 0.9 < np.mean(np.abs(errors) < 2.0) < 0.98
    corners = rng.normal(size=(3, 3))
    both = trilaterate(corners, np.linalg.norm(corners - truth, axis=1))
    assert min(np.linalg.norm(both - truth, axis=1)) < 1e-12


def test_base_frame_is_found(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    found = identify_axes(_readings(cell, chain_of(cell), _sweeps(range(2)), SIGMA), cell).base
    error = found.tracker @ np.linalg.inv(nominal_parameters(cell).tracker)
    assert np.linalg.norm(error[:3, 3]) < 5 * np.linalg.norm(found.std[:3]) < 5e-4
    assert np.linalg.norm(error[:3, :3] - np.eye(3)) < 8 * np.linalg.norm(found.std[3:]) < 1e-3
    assert abs(found.axis_angle_error) < 1e-4
    assert not found.warnings


def test_short_arcs_are_called_short(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    found = identify_axes(_readings(cell, chain_of(cell), _sweeps(range(2), arc=0.7), SIGMA), cell).base
    assert len(found.warnings) == 2
    assert "40 degrees" in found.warnings[0]


def test_axes_recover_known_geometry_errors(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    rng = np.random.default_rng(5)
    geometry = np.zeros((6, 6))
    geometry[2:, [0, 1]] = rng.normal(0, 5e-4, (4, 2))
    geometry[2:, [3, 4]] = rng.normal(0, 5e-4, (4, 2))
    chain = chain_of(cell)
    found = identify_axes(_readings(cell, chain.corrected(geometry), _sweeps(range(6)), 0.0), cell)
    np.testing.assert_allclose(found.geometry[2:, [3, 4]], geometry[2:, [3, 4]], atol=1e-7)
    np.testing.assert_allclose(found.geometry[2:, [0, 1]], geometry[2:, [0, 1]], atol=1e-7)
    assert found.not_observed == ()
    some = identify_axes(_readings(cell, chain, _sweeps(range(3)), SIGMA), cell)
    assert some.not_observed == ("joint_4", "joint_5", "joint_6")
    assert not some.geometry[3:].any()


def test_wrist_centre_is_found(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    chain = chain_of(cell)
    rng = np.random.default_rng(6)
    q = np.tile(HOME, (25, 1))
    q[:, 3:] += rng.uniform(-1.2, 1.2, (25, 3))
    found = identify_wrist_centre(_readings(cell, chain, q, SIGMA), cell, nominal_parameters(cell).points)
    truth = nominal_parameters(cell).tracker
    centre = posture(chain, HOME[None]).origin[4][:, 0]
    expected = truth[:3, :3].T @ (centre - truth[:3, 3])
    np.testing.assert_allclose(found.position, expected, atol=6e-5)
    assert found.spread < 1e-4
    assert not found.warnings
    np.testing.assert_array_less(np.abs(found.flange - [0.0, 0.0, -0.23]), 4 * found.std)


def test_a_wrist_whose_axes_do_not_meet_is_called_so(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    geometry = np.zeros((6, 6))
    geometry[5, 0] = 5e-3
    chain = chain_of(cell).corrected(geometry)
    q = np.tile(HOME, (25, 1))
    q[:, 3:] += np.random.default_rng(6).uniform(-1.2, 1.2, (25, 3))
    found = identify_wrist_centre(_readings(cell, chain, q, SIGMA), cell, nominal_parameters(cell).points)
    assert "may not meet in one point" in found.warnings[0]


def test_uncertain_points_make_an_uncertain_wrist_centre(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    q = np.tile(HOME, (25, 1))
    q[:, 3:] += np.random.default_rng(6).uniform(-1.2, 1.2, (25, 3))
    points = nominal_parameters(cell).points
    readings = _readings(cell, chain_of(cell), q, SIGMA)
    together = np.kron(np.ones((3, 3)), 1e-8 * np.eye(3))  # all points off alike: so is the centre
    exact, found = (identify_wrist_centre(readings, cell, points, c).covariance for c in (None, together))
    np.testing.assert_allclose(found - exact, 1e-8 * np.eye(3), atol=1e-12)


@pytest.mark.parametrize(("seeds", "within"), [(12, 0.25), pytest.param(40, 0.2, marks=pytest.mark.slow)])
def test_uncertainties_of_frame_and_axes_are_right(tmp_path: Path, seeds: int, within: float) -> None:
    cell = write_cell(tmp_path)
    chain, truth = chain_of(cell), nominal_parameters(cell).tracker
    pose, axes, centre = [], [], []
    for seed in range(seeds):
        found = identify_axes(_readings(cell, chain, _sweeps(range(6)), SIGMA, seed), cell)
        base, seen = found.base, found.std > 1e-12
        error = np.r_[base.tracker[:3, 3] - truth[:3, 3], rpy_of(base.tracker[:3, :3]) - rpy_of(truth[:3, :3])]
        pose.append(error / base.std)
        axes.append(found.geometry[seen] / found.std[seen])
        q = np.tile(HOME, (25, 1))
        q[:, 3:] += np.random.default_rng(seed).uniform(-1.2, 1.2, (25, 3))
        wrist = identify_wrist_centre(_readings(cell, chain, q, SIGMA, seed), cell, nominal_parameters(cell).points)
        centre.append((wrist.flange - [0.0, 0.0, -0.23]) / wrist.std)
    assert np.shape(axes) == (seeds, 18)
    for errors in (pose, axes, centre):
        assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=within)


def test_sweeps_are_found_in_long_recordings_at_once(tmp_path: Path) -> None:
    q = np.concatenate([np.random.default_rng(0).uniform(-1, 1, (20_000, 6)), _sweeps(range(1))])
    began = time.process_time()
    found = single_joint_sweeps(q, np.zeros(len(q), dtype=np.int64))
    assert time.process_time() - began < 2.0
    assert [(sweep.joints, len(sweep.rows)) for sweep in found] == [((0,), 25)]


@pytest.mark.parametrize(("joints", "expected"), [(range(1, 2), "joint_1"), (range(1), "joint_2")])
def test_missing_sweeps_are_named(tmp_path: Path, joints: range, expected: str) -> None:
    cell = write_cell(tmp_path)
    with pytest.raises(IdentificationError) as caught:
        identify_axes(_readings(cell, chain_of(cell), _sweeps(joints), SIGMA), cell)
    assert caught.value.place == expected


def test_a_wrist_that_does_not_move_is_refused(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = _readings(cell, chain_of(cell), np.tile(HOME, (9, 1)), SIGMA)
    with pytest.raises(IdentificationError):
        identify_wrist_centre(readings, cell, nominal_parameters(cell).points)


@pytest.mark.parametrize("points", [np.zeros((3, 3)), np.outer(np.arange(6.0), [1, 2, 3])])
def test_degenerate_points_are_refused(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="points"):
        fit_circle(points)
    with pytest.raises(ValueError, match="points"):
        fit_sphere(points)
