"""What the extended model leaves: noise, or something that nothing in the catalogue explains."""

from __future__ import annotations

import numpy as np
from scipy.stats import f as f_distribution

from calibration_core.diagnosis.design import Design
from calibration_core.diagnosis.extended import Extended
from calibration_core.diagnosis.finding import Rest
from calibration_core.diagnosis.noise import Scatter
from calibration_core.identification.distributions import chi2_tail
from calibration_core.timeseries import Float1D, Readings

SIGNIFICANT = 0.001
SMALLEST_EXCESS = 1.04  # of the noise: a smaller rest does not matter, however certain


def what_remains(extended: Extended, seen: Scatter, claimed: float, readings: Readings) -> Rest:
    """Test the rest of the extended model against the noise, and say where it is largest.

    F test against the noise that was seen; where none could be seen, chi-square test against the instruments' claim.

    Args:
        extended: The extended model.
        seen: The noise.
        claimed: What the instrument claims, m.
        readings: The recording, for the numbers of its configurations.
    """
    design = extended.design
    rest, ratio, freedom = weighted_rest(extended)
    trusted = seen.freedom > 0
    if trusted:
        sigma, tail = claimed * seen.total, float(f_distribution.sf(ratio, freedom, seen.freedom))
    else:  # nothing but the claim to compare with
        ratio *= seen.total**2
        sigma, tail = claimed, chi2_tail(ratio * freedom, freedom)
    beyond = tail < SIGNIFICANT
    excess = sigma * float(np.sqrt(max(ratio - 1, 0.0)))
    if not (beyond and np.sqrt(ratio) > SMALLEST_EXCESS):
        return Rest(excess, False, {}, "The rest agrees with the noise.")
    per = {int(k): float(np.mean(rest[design.configuration == k] ** 2)) for k in np.unique(design.configuration)}
    numbers = np.unique(readings.configuration)
    worst = sorted(per, key=lambda k: -per[k])[:5]
    where = {
        "configurations": [int(numbers[k]) for k in worst],
        "times_noise": [round(per[k] ** 0.5, 2) for k in worst],
    }
    text = (
        f"A rest of {1e6 * excess:.1f} µm per coordinate beyond the noise is not explained by the catalogue; largest "
        f"in configurations {', '.join(str(int(numbers[k])) for k in worst)}."
    )
    if not trusted:
        text += " Steps are too few to see the noise itself: it may be larger than claimed, or physics is missing."
    return Rest(excess, True, where, text)


def weighted_rest(extended: Extended) -> tuple[Float1D, float, int]:
    """Return what null model, nuisances and findings leave, (r,), its mean square and degrees of freedom."""
    design = extended.design
    parts = [design.null, *(design.columns[:, design.blocks[i]] for i in extended.accepted)]
    columns = np.column_stack([*parts, design.columns[:, design.nuisances]])
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    basis = u[:, s > 1e-8 * s[0]]
    rest = design.residual - basis @ (basis.T @ design.residual)
    freedom = max(len(rest) - basis.shape[1], 1)
    return rest, float(rest @ rest) / freedom, freedom


def held_out_error(design: Design, accepted: tuple[int, ...]) -> float:
    """Return the rms of the whitened prediction error of configurations left out (1 is the noise)."""
    n = design.n
    columns = np.column_stack([design.null, *(design.columns[:, design.blocks[i]] for i in accepted)])
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    ridge = np.full(columns.shape[1], 1e-9)
    ridge[n:] = 1 / scale[n:] ** 2  # the accepted keep their priors
    columns = columns / scale
    matrix, vector = columns.T @ columns + np.diag(ridge), columns.T @ design.residual
    squares = 0.0
    for number in np.unique(design.configuration):
        rows = design.configuration == number
        own, target = columns[rows], design.residual[rows]
        without = np.linalg.solve(matrix - own.T @ own, vector - own.T @ target)
        squares += float(((target - own @ without) ** 2).sum())
    return float(np.sqrt(squares / len(design.residual)))
