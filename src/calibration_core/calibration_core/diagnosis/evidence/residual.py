"""What the extended model leaves: noise, or something that nothing in the catalogue explains."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.linalg import svd

from calibration_core.diagnosis.data_checks.adequacy import against_noise
from calibration_core.diagnosis.data_checks.noise import Scatter
from calibration_core.diagnosis.evidence.design import Design
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.result.finding import Rest
from calibration_core.identification.statistics.distributions import f_tail
from calibration_core.model.effects.possible import nearest
from calibration_core.timeseries import Float1D, Float2D, Readings, numbers_in_time

ODD = 1e-4  # chance that a clean recording holds any configuration that is called odd


def what_remains(extended: ExtendedLoadedModel, seen: Scatter, claimed: float, readings: Readings) -> Rest:
    """Test the rest of the extended model against the noise, and say where it is largest.

    The noise is what was seen; where none could be seen, the instruments' claim.

    Args:
        extended: The extended model.
        seen: The noise.
        claimed: What the instrument claims, m.
        readings: The recording, for the numbers of its configurations.
    """
    design = extended.design
    rest, ratio, freedom = weighted_rest(extended)
    numbers = numbers_in_time(readings.configuration).tolist()
    trusted = seen.freedom > 0
    size = claimed * seen.total  # of one whitened row
    per = {
        numbers[k]: size * float(np.sqrt(np.mean(rest[design.configuration == k] ** 2)))
        for k in np.unique(design.configuration)
    }
    noise, noise_freedom = (size, seen.freedom) if trusted else (claimed, math.inf)  # nothing but the claim
    found = against_noise(size * float(np.sqrt(ratio)), freedom, noise, noise_freedom, per)
    odd = odd_configurations(rest, design, seen) if trusted and not found.significant else []
    if odd:
        listed = ", ".join(str(numbers[k]) for k in odd)
        text = (
            f"Configurations {listed} do not agree with the model within the noise, the others do: repeat them; a "
            "slip, a contact or a jump is more likely than physics of the robot."
        )
        found = dataclasses.replace(
            found, significant=True, where={"configurations": [numbers[k] for k in odd]}, text=text
        )
    if found.significant and not trusted:
        more = " Steps are too few to see the noise itself: it may be larger than claimed, or physics is missing."
        return dataclasses.replace(found, text=found.text + more)
    return found


def odd_configurations(rest: Float1D, design: Design, seen: Scatter) -> list[int]:
    """Return the indices of configurations whose rest is too large for the noise, by themselves, worst first."""
    numbers = np.unique(design.configuration)
    chances = {}
    for k in numbers:
        inside = design.configuration == k
        used_up = design.n / len(numbers)
        freedom = max(float(inside.sum()) - used_up, 1.0)
        power = float(rest[inside] @ rest[inside]) / freedom
        chances[int(k)] = f_tail(power, freedom, seen.freedom)
    return sorted((k for k in chances if chances[k] * len(numbers) < ODD), key=lambda k: chances[k])


def weighted_rest(extended: ExtendedLoadedModel) -> tuple[Float1D, float, int]:
    """Return what null model, discrepancy and findings leave, (r,), its mean square and degrees of freedom."""
    design = extended.design
    columns = design.known(extended.accepted)
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    u, s, _ = svd(columns, full_matrices=False, lapack_driver="gesvd")  # gesdd can fail where columns nearly repeat
    basis = u[:, s > 1e-8 * s[0]]
    rest = design.residual - basis @ (basis.T @ design.residual)
    freedom = max(len(rest) - basis.shape[1], 1)
    return rest, float(rest @ rest) / freedom, freedom


def held_out_error(design: Design, accepted: tuple[int, ...]) -> float:
    """Return the rms of the whitened prediction error of configurations left out (1 is the noise)."""
    columns = design.fitted(accepted)
    squares = 0.0
    for number, value in solutions(design, accepted)[1].items():
        rows = design.configuration == number
        squares += float(((design.residual[rows] - columns[rows] @ value) ** 2).sum())
    return float(np.sqrt(squares / len(design.residual)))


def solutions(design: Design, accepted: tuple[int, ...]) -> tuple[Float1D, dict[int, Float1D]]:
    """Fit the model to all configurations, and to all but one for every one; effects as physics allows them.

    Args:
        design: The whitened model.
        accepted: Its effects, which keep their priors.

    Returns:
        Factors (n + p,) of the columns of null model and effects, and by configuration left out the same.
    """
    n = design.n
    columns = design.fitted(accepted)
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    ridge = np.full(columns.shape[1], 1e-9)
    ridge[n:] = 1 / scale[n:] ** 2
    columns = columns / scale
    matrix, vector = columns.T @ columns + np.diag(ridge), columns.T @ design.residual
    several = [design.candidates[i].parameters for i in accepted]
    size = np.concatenate([np.zeros(0), *(design.prior[design.blocks[i]] for i in accepted)]) / scale[n:]

    def solved(normal: Float2D, right: Float1D) -> Float1D:
        inverse = np.linalg.inv(normal)
        value = inverse @ right
        allowed = nearest(several, value[n:] * size, inverse[n:, n:] * np.outer(size, size))
        if len(allowed.held):
            effects = allowed.value / size
            value = np.concatenate([np.linalg.solve(normal[:n, :n], right[:n] - normal[:n, n:] @ effects), effects])
        return np.asarray(value / scale)

    without = {}
    for number in np.unique(design.configuration):
        own, target = columns[design.configuration == number], design.residual[design.configuration == number]
        without[int(number)] = solved(matrix - own.T @ own, vector - own.T @ target)
    return solved(matrix, vector), without
