"""What a population saves: how few configurations give the wanted accuracy for the next robot of the type.

A measurement of k configurations knows ln K with a standard deviation of s sqrt(N / k), s being that of N
configurations; the population adds what it knows: 1 / var = k / (N s^2) + 1 / (spread^2 + mean_std^2), normal theory.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from calibration_core.fleet.plant import PooledQuantity
from calibration_core.fleet.pooling import Population

FEWEST = 3  # configurations: fewer do not determine six joints and the offsets of their points
MOST = 60
ALONE = 18  # configurations of the standard's measurement
AS_GOOD = 1.4  # spread over the standard deviation of eighteen configurations up to which six do as well with sisters
FEW = 6


@dataclasses.dataclass(frozen=True)
class Needed:
    """How many configurations one joint needs.

    Attributes:
        alone: Configurations without a population; None where `MOST` are not enough.
        together: With it.
    """

    joint: str
    alone: int | None
    together: int | None


def needed(
    expected: Mapping[str, float], configurations: int, populations: Mapping[str, Population], accuracy: float
) -> tuple[Needed, ...]:
    """Return how many configurations every joint needs.

    Args:
        expected: Joint -> standard deviation of ln stiffness that a plan promises.
        configurations: How many that plan has.
        populations: Joint -> what is known of sisters.
        accuracy: Wanted standard deviation of ln stiffness, e.g. 0.01 for 1 %.
    """
    found = []
    for joint, std in expected.items():
        sisters = populations.get(joint)
        alone, together = (_fewest(std, configurations, one, accuracy) for one in (None, sisters))
        found.append(Needed(joint, alone, together))
    return tuple(found)


def accuracy_with(std: float, configurations: int, count: int, sisters: Population | None) -> float:
    """Return the standard deviation of ln stiffness with `count` configurations and what is known of sisters."""
    information = count / (configurations * std**2)
    if sisters is not None:
        information += 1 / max(sisters.spread**2 + sisters.mean_std**2, 1e-12)
    return 1 / math.sqrt(information)


def _fewest(std: float, configurations: int, sisters: Population | None, accuracy: float) -> int | None:
    counts = range(FEWEST, MOST + 1)
    return next((k for k in counts if accuracy_with(std, configurations, k, sisters) <= accuracy * (1 + 1e-9)), None)


def saving(one: PooledQuantity) -> str:
    """Say from where on the population of a joint saves configurations; empty without a population."""
    if one.population is None:
        return ""
    std = float(np.median(np.concatenate([series.std for series in one.quantity.series])))
    ratio = one.population.spread / std
    joint = one.quantity.joint
    words = f"{joint}: sisters differ by {ratio:.1f} standard deviations of one measurement"
    if ratio <= AS_GOOD:
        return f"{words}; with the population, {FEW} configurations are as good as {ALONE} alone"
    equal = math.ceil(ALONE * (1 - 1 / ratio**2))  # k / (18 s^2) + 1 / spread^2 = 1 / s^2
    if equal < ALONE:
        return f"{words}; with the population, {equal} configurations are as good as {ALONE} alone"
    return f"{words}; the population saves no configuration"
