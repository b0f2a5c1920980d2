"""Instruments: the noise is as large as claimed, and faults do what they say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.cell import Tracker
from calibration_sim.cell.sensors import (
    ForceTorqueFaults,
    TrackerFaults,
    quantise,
    read_tracker,
    read_wrench,
    stream_noise,
    tracker_error,
)

CARTESIAN = Tracker(sigma=2e-5)
SPHERICAL = Tracker(sigma_range=1e-5, sigma_range_per_m=2e-6, sigma_angle=5e-6)
FINE = TrackerFaults(resolution=0.0)


def _rng() -> np.random.Generator:
    return np.random.default_rng(11)


def test_cartesian_noise_has_the_claimed_size_times_the_factor() -> None:
    true = np.zeros((20000, 3))
    normal = _rng().standard_normal(true.shape)
    for factor in (1.0, 1.5):
        shown = read_tracker(true, CARTESIAN, dataclasses.replace(FINE, noise_factor=factor), normal, _rng())
        assert shown.std(axis=0) == pytest.approx(factor * 2e-5, rel=0.03)


def test_spherical_noise_lies_along_range_and_angles() -> None:
    """Errors re-expressed in range, azimuth and elevation have the claimed standard deviations and do not correlate."""
    true = np.tile([2.0, -1.5, 0.9], (40000, 1))
    shown = true + tracker_error(true, SPHERICAL, _rng().standard_normal(true.shape))

    def spherical(p: np.ndarray) -> np.ndarray:
        reach = np.linalg.norm(p, axis=1)
        return np.column_stack([reach, np.arctan2(p[:, 1], p[:, 0]), np.arcsin(p[:, 2] / reach)])

    error = spherical(shown) - spherical(true)
    reach = np.linalg.norm(true[0])
    assert error.std(axis=0) == pytest.approx([1e-5 + 2e-6 * reach, 5e-6, 5e-6], rel=0.03)
    assert np.corrcoef(error.T) == pytest.approx(np.eye(3), abs=0.03)


def test_bias_resolution_and_outliers_of_the_tracker() -> None:
    true = np.random.default_rng(1).uniform(1.0, 2.0, (5000, 3))
    still = np.zeros_like(true)
    biased = read_tracker(true, CARTESIAN, TrackerFaults(bias=(1e-3, 0.0, -2e-3), resolution=0.0), still, _rng())
    assert biased - true == pytest.approx(np.tile([1e-3, 0.0, -2e-3], (5000, 1)), abs=1e-15)
    coarse = read_tracker(true, CARTESIAN, TrackerFaults(resolution=1e-4), still, _rng())
    assert coarse * 1e4 == pytest.approx(np.round(coarse * 1e4), abs=1e-9)
    assert np.max(np.abs(coarse - true)) <= 0.5e-4 + 1e-12
    wild = read_tracker(true, CARTESIAN, TrackerFaults(resolution=0.0, outlier_rate=0.1), still, _rng()) - true
    hit = np.any(wild != 0.0, axis=1)
    assert hit.mean() == pytest.approx(0.1, abs=0.02)
    assert wild[hit].std() == pytest.approx(5e-4, rel=0.1)


def test_wrench_noise_bias_and_resolution() -> None:
    true = np.tile([100.0, -50.0, 2000.0, 5.0, 0.0, -7.0], (20000, 1))
    sigma = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    bias = (3.0, 0.0, -1.0, 0.2, 0.0, 0.0)
    faults = ForceTorqueFaults(noise_factor=2.0, bias=bias, resolution_force=0.25, resolution_torque=0.1)
    shown = read_wrench(true, sigma, faults, _rng().standard_normal(true.shape))
    assert shown.mean(axis=0) - true[0] == pytest.approx(bias, abs=0.06)
    assert shown.std(axis=0) == pytest.approx(2.0 * sigma, rel=0.03)
    assert shown[:, :3] * 4 == pytest.approx(np.round(shown[:, :3] * 4), abs=1e-9)
    assert shown[:, 3:] * 10 == pytest.approx(np.round(shown[:, 3:] * 10), abs=1e-9)


def test_no_resolution_leaves_values_alone() -> None:
    values = _rng().standard_normal((10, 2))
    assert np.array_equal(quantise(values, 0.0), values)
    mixed = quantise(values, np.array([0.5, 0.0]))
    assert np.array_equal(mixed[:, 1], values[:, 1])
    assert set(np.unique(mixed[:, 0] * 2 % 1)) == {0.0}


@pytest.mark.parametrize(("rate", "window"), [(10.0, 2.0), (50.0, 2.0), (5.0, 0.2), (100.0, 0.5)])
def test_window_means_of_stream_noise_have_variance_one(rate: float, window: float) -> None:
    samples = max(1, round(rate * window))
    noise = stream_noise(_rng(), 4000 * samples, 3, rate=rate, window=window)
    means = noise.reshape(4000, samples, 3).mean(axis=1)
    assert means.std(axis=0) == pytest.approx(1.0, abs=0.06)
    assert abs(means.mean()) < 0.06
