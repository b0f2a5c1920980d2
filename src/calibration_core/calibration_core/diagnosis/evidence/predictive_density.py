"""Does a hypothesis predict configurations that it did not see?  Never rows, always whole configurations.

The expected log predictive density of every configuration given all others, in closed form from the joint normal
distribution of the recording (Sundararajan and Keerthi 2001): with precision Q, the prediction error of block k is
Q_kk^-1 (Q r)_k with covariance Q_kk^-1.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from calibration_core.diagnosis.evidence.bayes_factors import MarginalModel
from calibration_core.timeseries import Float1D, Float2D

FLAT = 1e3  # prior standard deviation of the null model's parameters, in units in which each column has length one
GATE = 3.0  # nats


def log_predictive_densities(f: MarginalModel, candidate: int) -> tuple[Float1D, Float1D]:
    """Return, per configuration, the log density of its readings given all others, without and with a hypothesis.

    With it, the precision changes by as many ranks as it has parameters (Woodbury).

    Args:
        f: The model; its discrepancy and accepted effects are part of the covariance.
        candidate: The hypothesis, added with its prior.

    Returns:
        Two arrays (k,), nats.
    """
    design = f.design
    norms = np.sqrt(np.clip(np.diag(f.cache.gram)[: design.n], 0.0, None))
    active = np.flatnonzero(f.weights > 0)
    wide = np.concatenate(
        [
            design.null * (FLAT / np.where(norms > 0, norms, 1.0)),
            design.columns[:, active] * f.weights[active],
        ],
        axis=1,
    )
    lower = np.linalg.cholesky(np.eye(wide.shape[1]) + wide.T @ wide)
    half = solve_triangular(lower, wide.T, lower=True, check_finite=False)
    scored = design.residual - half.T @ (half @ design.residual)
    block = design.columns[:, design.own(candidate)]
    seen = block - half.T @ (half @ block)
    root = np.linalg.cholesky(np.eye(block.shape[1]) + block.T @ seen)
    change = np.linalg.solve(root, seen.T)
    with_it = scored - change.T @ np.linalg.solve(root, block.T @ scored)
    numbers = np.unique(design.configuration)
    before, after = np.empty(len(numbers)), np.empty(len(numbers))
    for k, number in enumerate(numbers):
        rows = np.flatnonzero(design.configuration == number)
        precision = np.eye(len(rows)) - half[:, rows].T @ half[:, rows]
        before[k] = _log_density(precision, scored[rows])
        after[k] = _log_density(precision - change[:, rows].T @ change[:, rows], with_it[rows])
    return before, after


def _log_density(precision: Float2D, scored: Float1D) -> float:
    """Return the log density of a configuration whose precision is Q_kk and for which Q r is `scored`, nats."""
    sign, log_det = np.linalg.slogdet(precision)
    if sign <= 0:
        return -np.inf
    return 0.5 * float(log_det - np.linalg.solve(precision, scored) @ scored)


def passes(before: Float1D, after: Float1D) -> bool:
    """Apply the gate: more than three nats in all, and still a gain without the configuration that gains most."""
    gain = after - before
    return bool(gain.sum() > GATE and (len(gain) < 3 or gain.sum() - gain.max() > 0))
