"""The stated covariance of a mean is the covariance that means have."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.observations.average import autocorrelation_times, average, inliers, mean_of


def correlated(rng: np.random.Generator, memory: float, shape: tuple[int, int]) -> np.ndarray:
    """First-order autoregressive samples of unit variance along the last axis."""
    from scipy.signal import lfilter  # slow to load

    white = rng.normal(size=shape) * np.sqrt(1 - memory**2)
    white[:, 0] /= np.sqrt(1 - memory**2)
    return lfilter([1.0], [1.0, -memory], white, axis=1)


@pytest.mark.parametrize(("memory", "n"), [(0.0, 200), (0.5, 500), (0.9, 2000), (0.97, 5000)])
def test_variance_of_the_mean(memory: float, n: int) -> None:
    runs = correlated(np.random.default_rng(1), memory, (400, n))
    stated = np.mean([average(run[:, None]).covariance[0, 0] for run in runs])
    assert stated == pytest.approx(runs.mean(axis=1).var(), rel=0.2)


def test_white_noise_is_not_punished() -> None:
    runs = np.random.default_rng(2).normal(size=(400, 200))
    times = autocorrelation_times(runs - runs.mean(axis=0))
    assert times.min() >= 1.0
    assert times.mean() < 1.25


def test_oscillation_is_not_credited() -> None:
    assert autocorrelation_times(np.cos(np.arange(200) * np.pi * 0.9)[:, None]).tolist() == [1.0]


def test_covariance_between_components() -> None:
    mix = np.array([[1.0, 0.8], [0.0, 0.6]])
    values = np.random.default_rng(3).normal(size=(5000, 2)) @ mix
    result = average(values)
    assert result.covariance * 5000 == pytest.approx(mix.T @ mix, rel=0.15, abs=0.05)
    assert result.effective == pytest.approx(5000, rel=0.15)
    assert np.all(np.linalg.eigvalsh(result.covariance) > 0)


def test_few_samples() -> None:
    one = average(np.array([[1.0, 2.0, 3.0]]))
    assert one.mean.tolist() == [1, 2, 3]
    assert one.covariance.tolist() == np.zeros((3, 3)).tolist()
    assert (one.samples, one.effective) == (1, 1.0)
    two = average(np.array([[1.0], [3.0]]))
    assert two.mean[0] == 2.0
    assert two.covariance[0, 0] == pytest.approx(1.0)


def test_constant_samples() -> None:
    result = average(np.full((50, 3), 7.25))
    assert result.mean.tolist() == [7.25] * 3
    assert not result.covariance.any()


def test_wild_samples_are_left_out() -> None:
    values = np.random.default_rng(4).normal(size=(300, 3))
    values[[5, 100]] += [0.0, 40.0, 0.0]
    result = average(values)
    assert result.outliers == 2
    assert abs(result.mean[1]) < 0.3


@pytest.mark.parametrize("n", [12, 20, 100, 1000])
def test_noise_is_never_wild(n: int) -> None:
    runs = np.random.default_rng(5).normal(size=(2000, n, 1))
    assert sum(int((~inliers(run)).sum()) for run in runs) <= 2


def test_coarse_resolution_is_not_judged() -> None:
    values = np.zeros((100, 1))
    values[:30] = 1.0
    assert inliers(values).all()


@pytest.mark.parametrize("n", [1, 2, 7, 8, 40])
def test_the_mean_alone_is_the_mean_of_the_average(n: int) -> None:
    values = np.random.default_rng(n).normal(size=(n, 3))
    if n > 8:
        values[5] = 1e3
    assert mean_of(values).tolist() == average(values).mean.tolist()
    kept = values if n <= 8 else np.delete(values, 5, axis=0)
    assert mean_of(values).tolist() == kept.mean(axis=0).tolist()


@pytest.mark.parametrize("n", [30, 31, 40, 41])
def test_wild_samples_are_those_far_from_the_median(n: int) -> None:
    values = np.random.default_rng(n).normal(size=(n, 2))
    values[3, 1] = -60.0
    distance = np.abs(values - np.median(values, axis=0))
    assert distance[3, 1] > 8 * 1.4826 * np.median(distance, axis=0)[1]
    assert np.flatnonzero(~inliers(values)).tolist() == [3]
    values[2, 0] = np.nan  # an unknown component is not judged
    assert np.flatnonzero(~inliers(values)).tolist() == [3]
