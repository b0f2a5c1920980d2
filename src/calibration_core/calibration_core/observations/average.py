"""Mean of a plateau and the covariance of that mean, with autocorrelation taken into account.

Samples of one sensor at hundreds of hertz are not independent: vibration, turbulence and filters tie neighbours
together.  The variance of the mean of n samples is tau / n times their variance, with the integrated autocorrelation
time tau = 1 + 2 (rho_1 + rho_2 + ...).  The sum is cut off after Geyer (1992, "Practical Markov chain Monte Carlo",
initial monotone sequence): sums of neighbouring pairs are taken while they are positive, and made to decrease.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Bool1D, Float1D, Float2D

OUTLIER = 8.0  # robust standard deviations; beam breaks and glitches lie far beyond, noise never
SMALL_SAMPLE = 8.0  # the limit is wider by the factor 1 + this / n, as the scale of few samples is uncertain itself
MIN_FOR_OUTLIERS = 12


@dataclasses.dataclass(frozen=True, eq=False)
class Average:
    """Mean of samples.

    Attributes:
        mean: (k,).
        covariance: (k, k), of the mean; zero for a single sample, of which the scatter is unknown.
        samples: Number of samples averaged.
        effective: Number of independent samples that would give the same variance (worst component).
        outliers: Samples left out.
    """

    mean: Float1D
    covariance: Float2D
    samples: int
    effective: float
    outliers: int


def mean_of(values: Float2D) -> Float1D:
    """Return the mean (k,) of samples (n, k), n >= 1, wild ones left out; the same as that of `average`."""
    return np.asarray(values[inliers(values)].mean(axis=0))


def average(values: Float2D) -> Average:
    """Average samples (n, k), n >= 1, evenly spaced in time."""
    keep = inliers(values)
    used = values[keep]
    n, k = used.shape
    mean = np.asarray(used.mean(axis=0))
    dropped = len(values) - n
    if n < 2:
        return Average(mean, np.zeros((k, k)), n, float(n), dropped)
    deviations = used - mean
    tau = autocorrelation_times(deviations)
    scale = np.sqrt(tau / n)
    covariance = (deviations.T @ deviations / (n - 1)) * np.outer(scale, scale)
    return Average(mean, covariance, n, float(n / tau.max()), dropped)


def inliers(values: Float2D) -> Bool1D:
    """(n,) False for samples more than eight robust standard deviations off the median in any component.

    The scale is the median absolute deviation; a component in which it is zero (resolution coarser than the noise)
    is not judged.
    """
    keep = np.ones(len(values), np.bool_)
    if len(values) < MIN_FOR_OUTLIERS:
        return keep
    distance = np.abs(values - _median(values))
    scale = 1.4826 * _median(distance)
    judged = scale > 0
    limit = OUTLIER * (1.0 + SMALL_SAMPLE / len(values)) * scale
    keep &= (distance[:, judged] <= limit[judged]).all(axis=1)
    return keep


def _median(values: Float2D) -> Float1D:
    """Return the median (k,) of samples (n, k), as `np.median`, which spends most of its time on other cases."""
    if np.isnan(values).any():
        return np.asarray(np.median(values, axis=0))
    half = len(values) // 2
    if len(values) % 2:
        return np.asarray(np.partition(values, half, axis=0)[half])
    low, high = np.partition(values, [half - 1, half], axis=0)[half - 1 : half + 1]
    return np.asarray((low + high) / 2.0)


def autocorrelation_times(deviations: Float2D) -> Float1D:
    """Return the integrated autocorrelation time of every column of samples (n, k) without mean, (k,) in samples.

    At least 1, at most n / 2.  Negative correlation (an oscillation) is not credited: a mean is never held better than
    independent samples give.
    """
    n, k = deviations.shape
    times = np.ones(k)
    columns = np.ascontiguousarray(deviations.T)
    power = np.einsum("kn,kn->k", columns, columns)
    moving = np.flatnonzero(power > 0.0)
    if n < 4 or not len(moving):
        return times
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(columns[moving], size)
    rho = np.fft.irfft(spectrum * spectrum.conj(), size)[:, :n] / power[moving, None]
    for index, pairs in zip(moving, rho[:, : n // 2 * 2].reshape(len(moving), -1, 2).sum(axis=2), strict=True):
        negative = np.flatnonzero(pairs <= 0.0)
        falling = np.minimum.accumulate(pairs[: negative[0]] if len(negative) else pairs)
        times[index] = min(max(2.0 * float(falling.sum()) - 1.0, 1.0), n / 2)
    return times
