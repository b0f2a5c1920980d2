"""Is the rest of the fit noise?  The one judgement that an identification makes about its own model."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.statistics import beyond_noise

MODEL_FREE = frozenset({"rigid triangle", "window scatter"})
"""Ways of seeing the noise that neither the model nor hysteresis and creep of the robot can spoil."""

AXES = ("x", "y", "z")


@dataclasses.dataclass(frozen=True)
class ResidualVerdict:
    """What the identified model leaves, against the noise.

    Attributes:
        seen: Standard deviation of one coordinate of the residuals, degrees of freedom taken into account, m.
        noise: What it is compared with: the instruments' claim, or what was seen without the model if that is more, m.
        source: Where `noise` comes from.
        rms: The excess, sqrt(seen^2 - noise^2), m; 0 if there is none.
        significant: Whether the excess is beyond chance and more than 5 % of the noise, see `beyond_noise`.
        configurations: Configurations with the largest rest, largest first; empty if it is not significant.
        axis: Base axis with the largest rest; empty if it is not significant.
    """

    seen: float
    noise: float
    source: str
    rms: float
    significant: bool
    configurations: tuple[int, ...]
    axis: str


def rest(identification: Identification) -> ResidualVerdict:
    """Compare the residuals with the noise (F test, or chi-square test against the instruments' claim).

    Noise that was seen without any model (rigid triangle, scatter within a plateau) is no sign of missing
    physics; therefore the larger of claim and such a figure is the reference.
    """
    result = identification
    seen, freedom = result.fit.rms_after, max(3 * len(result.readings) - len(result.names), 1)
    noise, noise_freedom, source = result.noise.claimed, math.inf, "instruments"
    for check in result.noise.checks:
        if check.source == "residual":
            seen, freedom = check.seen, max(check.degrees_of_freedom, 1)
        elif check.source in MODEL_FREE and check.seen > noise:
            noise, noise_freedom, source = check.seen, float(check.degrees_of_freedom), check.source
    rms, significant = beyond_noise(seen, freedom, noise, noise_freedom)
    configurations, axis = _where(result) if significant else ((), "")
    return ResidualVerdict(
        seen=seen,
        noise=noise,
        source=source,
        rms=rms,
        significant=significant,
        configurations=configurations,
        axis=axis,
    )


def _where(result: Identification, most: int = 3) -> tuple[tuple[int, ...], str]:
    used = ~np.asarray(result.residuals.excluded, dtype=bool)
    scaled = (result.residuals.residual / result.residuals.sigma)[used]
    numbers, index = np.unique(result.readings.configuration[used], return_inverse=True)
    mean_square = np.bincount(index, np.sum(scaled**2, axis=1)) / np.bincount(index)
    worst = np.argsort(-mean_square, kind="stable")[:most]
    axis = AXES[int(np.argmax(np.sum(result.residuals.residual[used] ** 2, axis=0)))]
    return tuple(int(numbers[i]) for i in worst), axis
