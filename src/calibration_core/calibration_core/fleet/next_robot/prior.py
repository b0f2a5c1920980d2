"""A population as the prior of the next robot of its type: no recording is read again.

The measured logarithms y of the stiffnesses have the covariance S, that of the compliances divided by their values; the
population is normal with the spread between robots and the uncertainty of its mean.  A joint that lies farther from
the population than chance allows takes nothing from it: pooling refuses itself there.

Source: the conjugate update of normal distributions; Gelman et al., Bayesian Data Analysis, 3rd ed., 3.5.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration_core.diagnosis.result.finding import Finding
from calibration_core.fleet.findings import effect_name
from calibration_core.fleet.next_robot.population_file import TypePopulation
from calibration_core.fleet.plant import LEVEL
from calibration_core.fleet.recordings.rows import LARGEST_RELATIVE
from calibration_core.identification.statistics import normal_quantile
from calibration_core.model.effects.words import listed_location
from calibration_core.model.identified.gaussian import GaussianEstimate

COVERAGE = 1.959964
COMPLIANCE = "compliance."


@dataclasses.dataclass(frozen=True, eq=False)
class PooledJoint:
    """One joint beside its sisters, N*m/rad (N/m where a joint slides).

    Attributes:
        raw, raw_std: From the recording alone; the standard deviation to first order.
        pooled, pooled_std: With the populations of the joints that belong to theirs.
        low, high: 95 % interval of `pooled`.
        deviation: Standard deviations from the population; NaN where the recording tells nothing.
        belongs: Whether the joint belongs to the population.
    """

    joint: str
    raw: float
    raw_std: float
    pooled: float
    pooled_std: float
    low: float
    high: float
    deviation: float
    belongs: bool


def pooled_joints(estimate: GaussianEstimate, population: TypePopulation) -> tuple[PooledJoint, ...]:
    """Return the joints of a robot, measured and with what is known of its sisters.

    Args:
        estimate: Of a recording, with `compliance.JOINT` in rad/(N*m).
        population: Of the robot's type.
    """
    names = [f"{COMPLIANCE}{joint}" for joint in population.joints]
    kept = [k for k, name in enumerate(estimate.names) if name in names and _known(estimate, k)]
    chosen = estimate.chosen(kept)
    joints = [name.removeprefix(COMPLIANCE) for name in chosen.names]
    if not joints:
        return ()
    y = -np.log(chosen.value)
    covariance = chosen.covariance / np.outer(chosen.value, chosen.value)
    prior = [population.joints[joint] for joint in joints]
    mean = np.array([one.mean for one in prior])
    variance = np.array([one.spread**2 + one.mean_std**2 for one in prior])
    deviation = (y - mean) / np.sqrt(variance + np.diag(covariance))
    belongs = np.abs(deviation) <= normal_quantile(1 - LEVEL / (2 * len(joints)))
    # A joint that does not belong has a flat prior; what the others learn still reaches it through S.
    precision = np.diag(np.where(belongs, 1 / np.maximum(variance, 1e-12), 0.0))
    information = np.linalg.inv(covariance)
    pooled_covariance = np.linalg.inv(information + precision)
    pooled = pooled_covariance @ (information @ y + precision @ mean)
    std, raw_std = np.sqrt(np.diag(pooled_covariance)), np.sqrt(np.diag(covariance))
    return tuple(
        PooledJoint(
            joint, math.exp(y[k]), math.exp(y[k]) * float(raw_std[k]), math.exp(pooled[k]),
            math.exp(pooled[k]) * float(std[k]), math.exp(pooled[k] - COVERAGE * std[k]),
            math.exp(pooled[k] + COVERAGE * std[k]), float(deviation[k]), bool(belongs[k]),
        )
        for k, joint in enumerate(joints)
    )  # fmt: skip


def _known(estimate: GaussianEstimate, k: int) -> bool:
    value, std = float(estimate.value[k]), float(estimate.std[k])
    return value > 0 and 0 < std < LARGEST_RELATIVE * value


def finding_odds(findings: Sequence[Finding], population: TypePopulation) -> list[dict[str, Any]]:
    """Return, for every finding, the share of sisters that show it, and its evidence with that as the prior.

    Prior odds are (count + 1/2) / (others + 1/2), Jeffreys' estimate of the share.
    """
    records = []
    for one in findings:
        share = population.effects.get(effect_name(one.effect, listed_location(one.location)), 0.0)
        robots = max((member.members for member in population.joints.values()), default=0)
        odds = math.log((share * robots + 0.5) / ((1 - share) * robots + 0.5))
        records.append({
            "effect": one.effect, "location": dict(one.location), "share_of_robots": share,
            "log_prior_odds": odds, "log_posterior_odds": one.log_bayes_factor + odds,
        })  # fmt: skip
    return records


def prior_record(
    joints: Sequence[PooledJoint], findings: Sequence[dict[str, Any]], population: TypePopulation
) -> dict[str, Any]:
    """Return what result.json says of the population, with its provenance."""
    return {
        "type": population.type,
        "file": population.file,
        "sha256": population.sha256,
        "source": population.source,
        "joints": [dataclasses.asdict(joint) for joint in joints],
        "findings": list(findings),
    }


def prior_lines(joints: Sequence[PooledJoint], population: TypePopulation) -> list[str]:
    """Return the joints with and without the population, a line each."""
    lines = [f"with the population of type {population.type} ({population.source}; ± 95 %):"]
    for one in joints:
        raw = f"{one.joint}: {1e-5 * one.raw:.4g} ± {COVERAGE * 1e-5 * one.raw_std:.2g}"
        if one.belongs:
            pooled = f"{1e-5 * one.pooled:.4g} ± {COVERAGE * 1e-5 * one.pooled_std:.2g}"
            lines.append(f"  {raw} alone, {pooled} with its sisters, 10⁵ N·m/rad")
        else:
            far = f"{one.deviation:+z.1f} standard deviations"
            lines.append(f"  {raw} 10⁵ N·m/rad; it does not belong to its sisters ({far})")
    return lines
