"""Robots of one type as draws from their population: how much a value is believed, and whether a robot belongs to it.

The logarithm y of a joint's stiffness is population + robot + measurement:

    y_i = mu + tau b_i + s_i e_i,    b_i Student-t with nu degrees of freedom, e_i standard normal, s_i known.

A robot that differs much is not pulled towards its sisters, because the tails of Student's distribution are long.
Written as a mixture of normal distributions over the robot's own scale w (b = z / sqrt(w), w gamma), everything given
mu, tau and nu is closed form; mu, tau and nu are integrated over on a grid, and not set to their best values.

Sources: Efron and Morris (1975), doi:10.1080/01621459.1975.10479864; Lange, Little and Taylor (1989),
doi:10.1080/01621459.1989.10478852; populations of structures: arXiv 2204.12404.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.special import gammaln, ndtr

from calibration_core.identification.statistics import student_quantile
from calibration_core.policy import MAD
from calibration_core.timeseries import Bool1D, Float1D, Float2D

LEAST = 5  # robots from which a population is stated
DEGREES = (1.0, 4.0, 30.0)  # of freedom: very long tails (few robots that are far off), long ones, nearly normal ones
SCALES = np.exp(np.linspace(math.log(1e-5), math.log(20.0), 28))  # nodes of w
SPREADS, MEANS = 7, 3  # points of the grid over tau and mu
REACH = 2.0  # standard errors that the grid reaches to either side
BISECTIONS = 40
TAIL = 0.025
ROUNDS = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Population:
    """What is known of all robots of a type, for one joint: ln(N*m/rad), or the unit of what is pooled.

    Attributes:
        mean: Of the robots.
        spread: Standard deviation between robots that belong together, measurement taken off.
        mean_std: Standard error of `mean`.
        spread_std: Standard error of `spread`.
        members: Number of robots that it was estimated from: those that belong.
    """

    mean: float
    spread: float
    mean_std: float
    spread_std: float
    members: int


@dataclasses.dataclass(frozen=True, eq=False)
class Pooled:
    """Every robot beside its population.

    Attributes:
        population: Of those that belong.
        value: (m,) pooled values; the measured ones where pooling is refused.
        std: (m,) standard deviations.
        low, high: (m,) ends of the 95 % intervals.
        deviation: (m,) distance from the population in its standard deviations, measurement included.
        belongs: (m,) whether the robot belongs to the population.
    """

    population: Population
    value: Float1D
    std: Float1D
    low: Float1D
    high: Float1D
    deviation: Float1D
    belongs: Bool1D


def pool(
    value: Float1D, std: Float1D, critical: float, refused: Bool1D | None = None, *, judge_only: bool = False
) -> Pooled | None:
    """Pool the values of one quantity of all robots of a type.

    Args:
        value: (m,) measured, ln of a stiffness in N*m/rad.
        std: (m,) standard deviations of the measurement, positive.
        critical: Deviation, in standard deviations, beyond which a robot does not belong.
        refused: (m,) robots that are not pooled whatever they show; none where None.
        judge_only: Say who belongs, and pool nobody.

    Returns:
        None where fewer than `LEAST` robots belong: then nothing is known of a population.
    """
    population, members = core(value, std, critical)
    if population is None:
        return None
    deviation = (value - population.mean) / np.hypot(std, population.spread)
    belongs = members
    half = 1.959964 * std
    if judge_only:
        return Pooled(population, value, std, value - half, value + half, deviation, belongs)
    pooled = members if refused is None else members & ~refused
    mean, spread, low, high = posterior(value, std, population)
    return Pooled(
        population,
        np.where(pooled, mean, value),
        np.where(pooled, spread, std),
        np.where(pooled, low, value - half),
        np.where(pooled, high, value + half),
        deviation,
        belongs,
    )


def core(value: Float1D, std: Float1D, critical: float) -> tuple[Population | None, Bool1D]:
    """Estimate mean and spread by maximum likelihood from the robots that belong together; return them as well.

    Robots beyond `critical` standard deviations are set aside, and the estimate repeated until none changes sides;
    the first estimate is the median with the median absolute deviation.  Of few robots the spread is hardly known:
    the limit is that of Student's t with the same probability, for a robot beside a mean of so many.
    """
    critical = for_so_many(critical, len(value))
    mean = float(np.median(value))
    scatter = MAD * float(np.median(np.abs(value - mean)))
    spread = math.sqrt(max(scatter**2 - float(np.median(std)) ** 2, 0.0))
    members = np.abs(value - mean) <= critical * np.hypot(std, max(spread, 1e-12))
    for _ in range(ROUNDS):
        if np.count_nonzero(members) < LEAST:
            return None, members
        mean, spread = _likeliest(value[members], std[members])
        again = np.abs(value - mean) <= critical * np.hypot(std, spread)
        if np.array_equal(again, members):
            break
        members = again
    if np.count_nonzero(members) < LEAST:
        return None, members
    weight = 1 / (std[members] ** 2 + spread**2)
    # Normal theory away from zero; at zero the variance of the spread's square is what is known.
    at_zero = (2 / float(np.sum(weight**2))) ** 0.25
    away = 1 / (spread * math.sqrt(2 * float(np.sum(weight**2)))) if spread > 0 else math.inf
    spread_std, mean_std = min(at_zero, away), 1 / math.sqrt(float(np.sum(weight)))
    return Population(mean, spread, mean_std, spread_std, int(members.sum())), members


def for_so_many(critical: float, count: int) -> float:
    """Return the deviation from the mean of `count` values that chance exceeds as rarely as a normal one `critical`."""
    if count < LEAST:
        return critical
    return student_quantile(float(ndtr(critical)), count - 1) * math.sqrt(1 + 1 / count)


def _likeliest(value: Float1D, std: Float1D) -> tuple[float, float]:
    """Return mean and spread of restricted maximum likelihood, by bisection on the spread's score."""

    def score(variance: float) -> tuple[float, float]:
        weight = 1 / (std**2 + variance)
        mean = float(np.sum(weight * value) / np.sum(weight))
        gain = float(np.sum(weight**2 * (value - mean) ** 2) - np.sum(weight) + np.sum(weight**2) / np.sum(weight))
        return gain, mean

    low, high = 0.0, float(np.var(value)) * 4 + 1e-300
    if score(low)[0] <= 0:
        return score(0.0)[1], 0.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if score(middle)[0] > 0 else (low, middle)
    return score(low)[1], math.sqrt(low)


def posterior(value: Float1D, std: Float1D, population: Population) -> tuple[Float1D, Float1D, Float1D, Float1D]:
    """Return mean, standard deviation and ends of the 95 % interval (m,) of each robot's true value.

    Args:
        value: (m,) measured.
        std: (m,) of the measurement.
        population: What the robots come from; its uncertainty is integrated over.
    """
    means, taus, w, weights = _grid(value, std, population)
    own = taus[:, None] ** 2 / w[None, :]  # (g, k) variance of the robot about the population
    total = std[:, None, None] ** 2 + own  # (m, g, k)
    distance = value[:, None, None] - means[None, :, None]
    evidence = weights - 0.5 * (np.log(total) + distance**2 / total)
    evidence -= evidence.max(axis=(1, 2), keepdims=True)
    share = np.exp(evidence)
    share /= share.sum(axis=(1, 2), keepdims=True)
    gain = own / total
    centre, within = means[None, :, None] + gain * distance, gain * std[:, None, None] ** 2
    # One normal distribution for each scale: those of the grid lie close together.
    total_share = share.sum(axis=1)
    part = share / np.maximum(total_share, 1e-300)[:, None]
    middle = np.sum(part * centre, axis=1)
    width = np.sqrt(np.sum(part * (within + (centre - middle[:, None]) ** 2), axis=1))
    mean = np.sum(total_share * middle, axis=1)
    variance = np.sum(total_share * (width**2 + (middle - mean[:, None]) ** 2), axis=1)
    low, high = (_quantile(total_share, middle, width, tail) for tail in (TAIL, 1 - TAIL))
    return mean, np.sqrt(variance), low, high


def _grid(value: Float1D, std: Float1D, population: Population) -> tuple[Float1D, Float1D, Float1D, Float2D]:
    """Return mu (g,), tau (g,), w (k,) and the log weights (g, k) of hyper-parameters and scales, data included."""
    steps = np.linspace(-REACH, REACH, MEANS)
    floor = 0.02 * float(np.median(std))
    ends = np.clip(population.spread + REACH * population.spread_std * np.array([-1.0, 1.0]), floor, None)
    ends[1] = max(ends[1], 3 * floor)
    taus = np.exp(np.linspace(np.log(ends[0]), np.log(ends[1]), SPREADS))
    points = np.array([
        (population.mean + step * population.mean_std, tau, degrees)
        for step in steps for tau in taus for degrees in DEGREES
    ])  # fmt: skip
    mu, tau, nu = points.T
    half = nu[:, None] / 2
    # Density of w, gamma with shape and rate nu / 2, times w for steps that are equal in its logarithm.
    density = half * np.log(half) - gammaln(half) + half * np.log(SCALES) - half * SCALES
    density -= np.log(np.sum(np.exp(density), axis=1, keepdims=True))
    # The t distribution of scale tau has a standard deviation beyond tau: the grid is over that of the core.
    total = std[:, None, None] ** 2 + (tau[:, None] ** 2 / SCALES)[None]
    terms = density - 0.5 * (np.log(total) + (value[:, None, None] - mu[None, :, None]) ** 2 / total)
    top = terms.max(axis=2)
    likelihood = np.sum(top + np.log(np.sum(np.exp(terms - top[:, :, None]), axis=2)), axis=0)
    prior = np.log(tau)  # flat in tau, on a grid that is even in its logarithm
    return mu, tau, SCALES, (likelihood + prior)[:, None] + density


def _quantile(share: Float2D, centre: Float2D, width: Float2D, tail: float) -> Float1D:
    """Return the (m,) quantiles of mixtures of normal distributions, by bisection."""
    width = np.maximum(width, 1e-300)
    low = np.min(centre - 8 * width, axis=1)
    high = np.max(centre + 8 * width, axis=1)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        below = np.sum(share * ndtr((middle[:, None] - centre) / width), axis=1) < tail
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray((low + high) / 2)
