"""The noise is seen step by step, whatever smooth physics the model leaves out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robots import loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis.data_checks.adequacy import against_noise
from calibration_core.diagnosis.data_checks.loaded_anomalies import noise_understated
from calibration_core.diagnosis.data_checks.noise import claimed, directions, scatter, with_noise
from calibration_core.diagnosis.evidence.residual import Jumps, jumps_along_a_joint
from calibration_core.identification.statistics import whitened
from calibration_core.identification.stiffness.loaded import Options, PreparedLoaded, prepare_loaded
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.timeseries import Float2D, Float3D

SIGMA = 2e-5


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> PreparedLoaded:
    cell: Cell = write_cell(tmp_path_factory.mktemp("cell"))
    return prepare_loaded(loaded_readings(cell, 4, 30, noise=0.0), cell, Options(robust=False))


def seen(prepared: PreparedLoaded, residual: Float2D, tracker: Float2D | None = None):
    problem = prepared.problem
    rows = problem.linearise(prepared.fit.compliance).rows
    rows = dataclasses.replace(rows, shared=np.zeros_like(rows.shared))
    axes = directions(problem.readings, tracker)
    return rows, axes, scatter(rows, residual, problem.readings, axes)


def test_white_noise_is_seen_at_its_size(prepared: PreparedLoaded) -> None:
    rng = np.random.default_rng(1)
    _, _, found = seen(prepared, 1.4 * SIGMA * rng.standard_normal((450, 3)))
    assert found.total == pytest.approx(1.4, rel=0.06)
    assert found.shared == 0


def test_smooth_functions_of_the_load_are_not_taken_for_noise(prepared: PreparedLoaded) -> None:
    rng = np.random.default_rng(2)
    level = prepared.problem.readings.wrench[:, :1] / 1000  # type: ignore[index]
    physics = 20 * SIGMA * (level + 0.3 * level**2) * [1.0, -0.5, 0.2]
    _, _, found = seen(prepared, physics + SIGMA * rng.standard_normal((450, 3)))
    assert found.total == pytest.approx(1.0, rel=0.08)


def test_what_the_points_of_a_step_share_is_told_from_their_own(prepared: PreparedLoaded) -> None:
    rng = np.random.default_rng(3)
    own = SIGMA * rng.standard_normal((450, 3))
    together = 1.5 * SIGMA * np.repeat(rng.standard_normal((150, 3)), 3, axis=0)
    rows, axes, found = seen(prepared, own + together)
    assert np.mean(found.own) == pytest.approx(1.0, rel=0.1)
    assert found.shared == pytest.approx(1.5, rel=0.3)
    noisy = with_noise(rows, prepared.problem.readings, found, axes)
    white, _ = whitened(noisy, (own + together)[:, :, None])
    assert np.mean(white**2) == pytest.approx(1.0, rel=0.2)


def test_a_shared_part_that_may_last_is_no_understated_noise(prepared: PreparedLoaded) -> None:
    """Where it may last over the steps, most of it is a smooth function of the load, and what is seen is little."""
    rng, totals = np.random.default_rng(8), []
    for _ in range(20):
        own, shared = rng.standard_normal((450, 3)), 0.45 * np.repeat(rng.standard_normal((150, 3)), 3, axis=0)
        claimed_noise = SIGMA / np.sqrt(1 + 0.45**2) * (own + shared)
        found, twice = (seen(prepared, factor * claimed_noise)[2] for factor in (1.0, 2.0))
        totals.append(found.total)
        assert noise_understated(found, SIGMA) == ()
        assert [one.kind for one in noise_understated(twice, SIGMA)] == ["noise_understated"]
    assert max(totals) > 1.2  # a part that lasts is more likely by chance


def test_range_and_angles_may_differ(prepared: PreparedLoaded) -> None:
    rng = np.random.default_rng(4)
    tracker = prepared.parameters.tracker
    axes = directions(prepared.problem.readings, tracker)
    errors = np.einsum("mi,mia->ma", SIGMA * rng.standard_normal((450, 3)) * [0.5, 1.2, 1.2], axes)
    _, _, found = seen(prepared, errors, tracker)
    np.testing.assert_allclose(found.own, [0.5, 1.2, 1.2], rtol=0.12)


@pytest.mark.parametrize("claims", ["by step", "by point", "by reading"])
def test_offsets_are_not_taken_for_noise_where_the_claim_differs_from_reading_to_reading(
    prepared: PreparedLoaded, claims: str
) -> None:
    """Averages of a bag state a covariance each; what the geometry is off by stays an offset all the same."""
    rng = np.random.default_rng(6)
    problem = prepared.problem
    readings, linear = problem.readings, problem.linearise(prepared.fit.compliance)
    drawn = {"by step": (150, 1), "by point": (1, 3), "by reading": (150, 3)}[claims]
    sizes = SIGMA * np.broadcast_to(rng.uniform(0.6, 1.8, drawn), (150, 3)).ravel()
    rows = dataclasses.replace(
        linear.rows, noise=sizes[:, None, None] ** 2 * np.eye(3), shared=np.zeros_like(linear.rows.shared)
    )
    offsets = 2e-3 * rng.standard_normal((30, 3))[readings.configuration - readings.configuration.min()]
    residual = offsets + sizes[:, None] * rng.standard_normal((450, 3))
    found = scatter(rows, residual, readings, directions(readings, None))
    assert found.total == pytest.approx(1.0, rel=0.08)
    assert found.shared == 0


def test_two_steps_cannot_tell(prepared: PreparedLoaded) -> None:
    problem = prepared.problem.select(np.flatnonzero(prepared.problem.readings.step < 2))
    rows = problem.linearise(prepared.fit.compliance).rows
    found = scatter(rows, np.ones((180, 3)), problem.readings, directions(problem.readings, None))
    assert found == claimed()
    assert found.freedom == 0


def jumps(prepared: PreparedLoaded, residual: Float2D) -> Jumps | None:
    rows, axes, found = seen(prepared, residual)
    return jumps_along_a_joint(rows, residual, prepared.problem.readings, axes, _answer(prepared), found)


def _answer(prepared: PreparedLoaded) -> Float3D:
    problem = prepared.problem
    at = posture(problem.chain, problem.readings.q)
    points = np.array([problem.parameters.points[name] for name in problem.readings.points])[problem.readings.point].T
    return linear_jacobian(at, at.point(points)).transpose(2, 1, 0)


def _noise(rng: np.random.Generator) -> Float2D:
    """Return noise of every reading, and more that the points of a step share."""
    own, together = rng.standard_normal((450, 3)), np.repeat(rng.standard_normal((150, 3)), 3, axis=0)
    return SIGMA * (own + 1.5 * together)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_a_joint_that_jumps_is_distinguished_from_the_noise_that_steps_share(
    prepared: PreparedLoaded, joint: int
) -> None:
    rng = np.random.default_rng(5)
    answer = _answer(prepared)[:, :, joint]
    jumping = answer * np.repeat(rng.standard_normal(150), 3)[:, None]
    size = float(np.sqrt(np.mean(np.sum(jumping**2, axis=1))))
    found = jumps(prepared, _noise(rng) + jumping * (4 * SIGMA / size))
    assert found is not None
    assert found.joint == joint
    assert found.rms == pytest.approx(4 * SIGMA, rel=0.35)
    assert 0.5 < found.share < 1.0


@pytest.mark.parametrize("recordings", [50, pytest.param(300, marks=pytest.mark.slow)])
def test_noise_that_steps_share_follows_no_joint(prepared: PreparedLoaded, recordings: int) -> None:
    """At a chance of 1e-4, not one of 300 recordings."""
    assert [seed for seed in range(recordings) if jumps(prepared, _noise(np.random.default_rng(1000 + seed)))] == []


def test_a_load_that_is_not_followed_jumps_nowhere(prepared: PreparedLoaded) -> None:
    assert jumps(prepared, np.zeros((450, 3))) is None


def test_what_the_residual_is_compared_with_is_named() -> None:
    found = against_noise(1e-3, 100, 4.5e-5, np.inf, {7: 1e-3}, "1.5 times the stated noise")
    assert "are more than 1.5 times the stated noise (45.0 µm) and not explained" in found.text
