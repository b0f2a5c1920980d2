"""How probable it is that parameters which are jointly normal are all positive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

TINY = 1e-9  # keeps variances positive


def log_positive(mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the log probability that all of k joint normal variables are positive, (..., s).

    One after another: after each, the others are given the moments that they have where it is positive, and are taken
    as normal again (Mendell and Elston 1974); exact for independent variables, and right in the far tail.

    Args:
        mean: (..., k, s).
        covariance: (..., k, k).
    """
    k = mean.shape[-2]
    mean = mean.copy()
    spread = np.repeat(covariance[..., None], mean.shape[-1], axis=-1)  # (..., k, k, s)
    result = np.zeros((*mean.shape[:-2], mean.shape[-1]))
    for i in range(k):
        std = np.sqrt(spread[..., i, i, :])
        z = mean[..., i, :] / std
        share = log_ndtr(z)
        result += share
        if i == k - 1:
            break
        mills = np.exp(-0.5 * z**2 - share) / np.sqrt(2 * np.pi)
        cross = spread[..., i, i + 1 :, :] / std[..., None, :]
        mean[..., i + 1 :, :] += cross * mills[..., None, :]
        narrower = np.clip(mills * (mills + z), 0.0, 1.0 - TINY)[..., None, None, :]
        spread[..., i + 1 :, i + 1 :, :] -= narrower * cross[..., :, None, :] * cross[..., None, :, :]
    return result
