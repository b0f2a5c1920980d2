"""Tails and quantiles of the distributions that the tests need, on `scipy.special` alone (quick to load)."""

from __future__ import annotations

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
