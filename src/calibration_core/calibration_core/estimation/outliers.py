"""Gross errors: readings that the extended model does not explain, and those that it explains after all."""

from __future__ import annotations

import numpy as np

from calibration_core.estimation.refit import Extended
from calibration_core.identification.statistics.beyond_noise import FINEST
from calibration_core.identification.statistics.distributions import chi2_limit
from calibration_core.timeseries import Bool1D

GROSS = 0.01  # probability that a clean recording has any reading beyond the limit
MOST_SHARE = 0.05  # of the readings


def settled(extended: Extended) -> Bool1D:
    """Return (m,) which readings are to be used, judged by what the extended model leaves of them."""
    squares = np.sum(extended.rest.reshape(-1, 3) ** 2, axis=1)
    used = extended.model.used
    scale = float(np.median(squares[used])) / chi2_limit(0.5, 3)
    limit = max(scale, extended.variance, FINEST**2) * chi2_limit(GROSS / len(squares), 3)
    keep = squares < limit
    if np.mean(~keep) > MOST_SHARE:
        return used
    return np.asarray(keep)
