"""Tails and quantiles of the distributions that the tests need, on `scipy.special` alone (quick to load)."""

from __future__ import annotations

import math

from scipy.special import betaincinv, chdtrc, chdtri, fdtrc, ndtri, stdtrit

LEVEL = 0.01  # a claim, or agreement, is rejected at this level


def normal_quantile(probability: float) -> float:
    """Return the value that a standard normal variable stays below with this probability."""
    return float(ndtri(probability))


def student_quantile(probability: float, freedom: float) -> float:
    """Return the value that Student's t stays below with this probability."""
    return float(stdtrit(freedom, probability))


def chi2_tail(value: float, freedom: float) -> float:
    """Return the probability that chi-square exceeds a value."""
    return float(chdtrc(freedom, value))


def chi2_limit(probability: float, freedom: float) -> float:
    """Return the value that chi-square exceeds with this probability."""
    return float(chdtri(freedom, probability))


def f_tail(value: float, upper: float, lower: float) -> float:
    """Return the probability that F, with these degrees of freedom above and below the line, exceeds a value."""
    return 1.0 if value <= 0 else float(fdtrc(upper, lower, value))


def f_limit(probability: float, upper: float, lower: float) -> float:
    """Return the value that F exceeds with this probability.

    By way of the beta distribution, whose lower tail keeps its digits where the probability is tiny.
    """
    share = float(betaincinv(lower / 2, upper / 2, probability))
    return lower * (1 - share) / (upper * share)


SIGNIFICANT = 0.001  # chance of calling noise a residual
FINEST = 1e-3  # of the claimed noise: what is smaller is rounding, as of a simulation without noise
SMALLEST_EXCESS = 1.05  # of the noise: a smaller residual does not matter, however certain


def beyond_noise(seen: float, freedom: float, noise: float, noise_freedom: float = math.inf) -> tuple[float, bool]:
    """Return by how much a residual exceeds the noise, m rms, and whether that is beyond chance and of any importance.

    F test against noise that was seen; chi-square test against noise that is stated.

    Args:
        seen: Standard deviation of one coordinate of the residual, m.
        freedom: Its degrees of freedom.
        noise: Standard deviation of one coordinate of the noise, m, known without the model.
        noise_freedom: Degrees of freedom from which it is known; infinity: it is stated.
    """
    excess = math.sqrt(max(seen**2 - noise**2, 0.0))
    if not seen > SMALLEST_EXCESS * noise:
        return excess, False
    if noise <= 0:
        return excess, True
    ratio = (seen / noise) ** 2
    stated = math.isinf(noise_freedom)
    tail = chi2_tail(ratio * freedom, freedom) if stated else f_tail(ratio, freedom, max(noise_freedom, 1.0))
    return excess, tail < SIGNIFICANT
