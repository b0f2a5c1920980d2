"""Is what a model leaves more than noise?  The one test of it, for `identify` and `diagnose` and every recording."""

from __future__ import annotations

import math

from calibration_core.identification.statistics.distributions import chi2_tail, f_tail

SIGNIFICANT = 0.001  # chance of calling noise a residual
FINEST = 1e-3  # of the claimed noise: what is smaller is rounding, as of a simulation without noise
SMALLEST_EXCESS = 1.05  # of the noise: a smaller residual does not matter, however certain


def beyond_noise(seen: float, freedom: float, noise: float, noise_freedom: float = math.inf) -> tuple[float, bool]:
    """Return by how much a residual exceeds the noise, m rms, and whether that is beyond chance and of any importance.

    F test against noise that was seen; chi-square test against noise that is stated.

    Args:
        seen: Standard deviation of one coordinate of the residual, m.
        freedom: Its degrees of freedom.
        noise: Standard deviation of one coordinate of the noise, m, known without the model.
        noise_freedom: Degrees of freedom from which it is known; infinity: it is stated.
    """
    excess = math.sqrt(max(seen**2 - noise**2, 0.0))
    if not seen > SMALLEST_EXCESS * noise:
        return excess, False
    if noise <= 0:
        return excess, True
    ratio = (seen / noise) ** 2
    stated = math.isinf(noise_freedom)
    tail = chi2_tail(ratio * freedom, freedom) if stated else f_tail(ratio, freedom, max(noise_freedom, 1.0))
    return excess, tail < SIGNIFICANT
