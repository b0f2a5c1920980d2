"""Does a hypothesis predict configurations that it did not see?  Never rows, always whole configurations.

The expected log predictive density of every configuration given all others, in closed form from the joint normal
distribution of the recording (Sundararajan and Keerthi 2001): with precision Q, the prediction error of block k is
Q_kk^-1 (Q r)_k with covariance Q_kk^-1.
"""

from __future__ import annotations

import numpy as np

from calibration_core.diagnosis.evidence import Field
from calibration_core.timeseries import Float1D

FLAT = 1e3  # prior standard deviation of the null model's parameters, in units in which each column has length one
GATE = 3.0  # nats


def log_predictive_density(f: Field, more: tuple[int, ...] = ()) -> Float1D:
    """Return, per configuration, the log density of its readings given all others, (k,) nats.

    Args:
        f: The field; its discrepancy, nuisances and accepted effects are part of the covariance.
        more: Further hypotheses that the model contains, with their priors.
    """
    design = f.design
    norms = np.linalg.norm(design.null, axis=0)
    weights = f.weights.copy()
    for index in more:
        block = design.blocks[index]
        weights[block] = np.hypot(weights[block], 1.0)
    active = weights > 0
    wide = np.concatenate(
        [design.null / np.where(norms > 0, norms, 1.0) * FLAT, design.columns[:, active] * weights[active]], axis=1
    )
    inner = np.linalg.inv(np.eye(wide.shape[1]) + wide.T @ wide)
    scored = design.residual - wide @ (inner @ (wide.T @ design.residual))
    numbers = np.unique(design.configuration)
    density = np.empty(len(numbers))
    for k, number in enumerate(numbers):
        rows = design.configuration == number
        own = wide[rows]
        precision = np.eye(len(own)) - own @ inner @ own.T
        precision = (precision + precision.T) / 2
        sign, log_det = np.linalg.slogdet(precision)
        error = np.linalg.solve(precision, scored[rows])
        density[k] = 0.5 * (log_det - float(error @ scored[rows])) if sign > 0 else -np.inf
    return density


def passes(before: Float1D, after: Float1D) -> bool:
    """Apply the gate: more than three nats in all, and still a gain without the configuration that gains most."""
    gain = after - before
    return bool(gain.sum() > GATE and (len(gain) < 3 or gain.sum() - gain.max() > 0))
