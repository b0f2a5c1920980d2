"""What a choice of configurations promises before the day in the cell: the uncertainty of every joint's stiffness."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.model.parameters import ModelParameters
from calibration_core.planning.optimal_design.criteria import Observability
from calibration_core.planning.optimal_design.design import ExchangeResult
from calibration_core.planning.optimal_design.optimum import INVISIBLE, Candidates
from calibration_core.planning.plans.plan import Expected
from calibration_core.planning.route import Duration
from calibration_core.timeseries import Bool1D, Float3D

LEAST_REST = 1e-8  # of the information on a parameter, that must remain when those before it are free


def determined(information: Float3D) -> Bool1D:
    """Tell which parameters all candidates together can determine, (n,), those before preferred to those after.

    Args:
        information: (m, n, n), positive semi-definite.
    """
    total = information.sum(axis=0)
    diagonal = np.diag(total)
    shown = diagonal > INVISIBLE * diagonal.max(initial=0.0)
    scale = 1.0 / np.sqrt(np.where(shown, diagonal, 1.0))
    gram = total * scale[:, None] * scale
    taken: list[int] = []
    for i in np.flatnonzero(shown):
        rest = gram[i, i]
        if taken:
            rest -= gram[i, taken] @ np.linalg.solve(gram[np.ix_(taken, taken)], gram[taken, i])
        if rest > LEAST_REST:
            taken.append(int(i))
    mask = np.zeros(len(diagonal), dtype=bool)
    mask[taken] = True
    return mask


def expected_of(
    candidates: Candidates,
    choice: ExchangeResult,
    determinable: Bool1D,
    parameters: ModelParameters,
    *,
    spread: float,
    travel_time: float,
    unclear: int,
    duration: Duration,
    k_csm: float,
    unjudged: tuple[str, ...],
) -> Expected:
    """Return what a choice promises.

    Args:
        candidates: Information on the compliances that are determined.
        choice: Of these candidates.
        determinable: (n,) which compliances these are.
        parameters: Nominal compliances, zero where not known.
        spread: m, mean distance from a place of the operating space to the nearest configuration.
        travel_time: s, between configurations.
        unclear: Motions whose straight path is not clear.
        duration: How long it takes.
        k_csm: m, largest movement by the complementary stiffness.
        unjudged: Pairs of bodies that were not held against each other.
    """
    total = candidates.total(choice.chosen)
    covariance = np.linalg.inv(total) * candidates.scale[:, None] * candidates.scale
    std = np.full(len(determinable), np.inf)
    std[determinable] = np.sqrt(np.diag(covariance))
    relative = worst = mean = None
    if np.all(parameters.compliance > 0):
        # a small relative error of a compliance is that of its stiffness
        relative = std / parameters.compliance
        known = parameters.compliance[determinable]
        share = covariance / np.outer(known, known)
        mean = float(np.sqrt(np.trace(share) / len(share)))
        worst = float(np.sqrt(np.linalg.eigvalsh(share)[-1]))
    figures = Observability.of(total / len(choice.chosen))
    return Expected(
        efficiency=choice.efficiency,
        condition=figures.condition,
        compliance_std=std,
        stiffness_std=relative,
        a_value=mean,
        e_value=worst,
        spacing=spread,
        travel=travel_time,
        unclear_moves=unclear,
        criterion=choice.criterion.name,
        observability={k: v for k, v in dataclasses.asdict(figures).items() if k != "condition"},
        duration=duration.named,
        k_csm=k_csm,
        unjudged=unjudged,
    )
