"""The uncertainty of compliances where the rest is more than noise: what whole configurations say of them, scattered.

A rest that nothing explains is no noise: within a configuration it is alike from step to step, and the covariance by
the noise counts it far too often.  Taken by whole configurations it counts once each.
Source: Liang and Zeger 1986 (scatter of blocks).
"""

from __future__ import annotations

import numpy as np

from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.timeseries import Float2D

TINY = 1e-12  # of columns of length one: directions below it stay as they are


def scattered_covariance(extended: ExtendedLoadedModel) -> Float2D:
    """Return the (n, n) covariance of the compliances, (rad/(N*m))^2, each variance at least that of the scatter.

    Args:
        extended: The extended model of a loaded recording.
    """
    design = extended.design
    columns = design.known(extended.accepted)
    length = np.linalg.norm(columns, axis=0)
    length = np.where(length > 0, length, 1.0)
    columns = columns / length
    prior = np.where(np.arange(len(length)) < design.n, 0.0, 1.0 / length**2)
    inverse = np.linalg.pinv(columns.T @ columns + np.diag(prior), rcond=TINY, hermitian=True)
    rest = design.residual - columns @ (inverse @ (columns.T @ design.residual))
    numbers, label = np.unique(design.configuration, return_inverse=True)
    scores = np.stack([np.bincount(label.reshape(-1), column * rest) for column in columns.T], axis=1)
    scores *= np.sqrt(len(numbers) / max(len(numbers) - 1, 1))
    scatter = np.linalg.norm(scores @ inverse, axis=0)[: design.n] / length[: design.n]
    std = extended.compliance_std
    wider = np.maximum(1.0, np.divide(scatter, std, out=np.ones_like(std), where=std > 0))
    return np.asarray(extended.compliance_covariance * np.outer(wider, wider))
