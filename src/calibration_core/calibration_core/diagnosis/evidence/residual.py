"""What the extended model leaves: noise, or something that nothing in the catalogue explains."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.linalg import svd

from calibration_core.cell import Cell
from calibration_core.diagnosis.data_checks.adequacy import against_noise
from calibration_core.diagnosis.data_checks.noise import Scatter, claimed_along, step_groups
from calibration_core.diagnosis.evidence.design import Design
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.result.finding import Rest
from calibration_core.identification.statistics import FINEST, Rows, f_tail
from calibration_core.identification.stiffness.problem import counted, relative
from calibration_core.model.effects.possible import nearest
from calibration_core.timeseries import Float1D, Float2D, Float3D, Readings, numbers_in_time


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
    if found.significant and not trusted:
        more = " Steps are too few to see the noise itself: it may be larger than claimed, or physics is missing."
        return dataclasses.replace(found, text=found.text + more)
    return found


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


def held_out_ratio(design: Design, accepted: tuple[int, ...]) -> float:
    """Return the rms of the prediction error of configurations left out, over what noise and discrepancy make it.

    With columns X of ridge R, discrepancy D of size one and noise of size one, the error of rows b has the covariance
    1 + X_b (X'X - X_b'X_b + R)^-1 X_b' + E E', E = D_b - X_b (X'X - X_b'X_b + R)^-1 (X'D - X_b'D_b).
    """
    columns, scale, ridge = _scaled(design, accepted)
    usual = design.columns[:, design.discrepancy]
    matrix, across, expected, seen = columns.T @ columns + np.diag(ridge), columns.T @ usual, 0.0, 0.0
    for number, value in solutions(design, accepted)[1].items():
        rows = design.configuration == number
        seen += float(((design.residual[rows] - columns[rows] @ (value * scale)) ** 2).sum())
        own, also = columns[rows], usual[rows]
        through = np.linalg.solve(matrix - own.T @ own, np.column_stack([own.T, across - own.T @ also]))
        k = len(own)
        expected += k + float(np.sum(own.T * through[:, :k])) + float(np.sum((also - own @ through[:, k:]) ** 2))
    return float(np.sqrt(seen / expected))


def _scaled(design: Design, accepted: tuple[int, ...]) -> tuple[Float2D, Float1D, Float1D]:
    """Return the columns (r, n + p) of null model and effects, of length one, their lengths, and their ridge."""
    columns = design.fitted(accepted)
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    ridge = np.full(columns.shape[1], 1e-9)
    ridge[design.n :] = 1 / scale[design.n :] ** 2
    return columns / scale, scale, ridge


def solutions(design: Design, accepted: tuple[int, ...]) -> tuple[Float1D, dict[int, Float1D]]:
    """Fit the model to all configurations, and to all but one for every one; effects as physics allows them.

    Returns:
        Factors (n + p,) of the columns of null model and effects, and by configuration left out the same.
    """
    n = design.n
    columns, scale, ridge = _scaled(design, accepted)
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


CHANCE = 1e-4  # that jumps of a tracker follow any joint
LEAST = 1e-9  # of a movement per unit of noise: a joint that moves nothing has no line


@dataclasses.dataclass(frozen=True)
class Jumps:
    """What jumps along with one joint.

    Attributes:
        rms: m, of the points' movement along the joint's line, the noise taken off.
        share: Of the power of all jumps, that the joint's line holds.
    """

    joint: int
    rms: float
    share: float


def jumps_along_a_joint(
    rows: Rows, residual: Float2D, readings: Readings, axes: Float3D, answer: Float3D, seen: Scatter
) -> Jumps | None:
    """Return the joint that jumps from step to step follow; None where they follow none, or steps are too few.

    Args:
        rows: Grouping and claimed noise of the m readings.
        residual: (m, 3) m, what the model leaves.
        readings: The same readings.
        axes: (m, 3, 3) directions in which the tracker errs independently.
        answer: (m, 3, n) movement of the points by each joint.
        seen: The noise.
    """
    own = np.array(seen.own)
    lines = np.einsum("mia,man->min", axes, answer) / (claimed_along(rows, axes) * own)[:, :, None]
    stated = float(np.sqrt(np.einsum("mii->m", rows.noise).mean() / 3))
    along, raw = np.zeros(answer.shape[2]), np.zeros(answer.shape[2])
    whole = whole_raw = 0.0
    count = 0
    for number, group in step_groups(rows, residual, readings, axes).items():
        line = lines[rows.configuration == number].mean(axis=0)
        length = np.linalg.norm(line, axis=0)
        line = line * (length > LEAST * length.max(initial=0.0)) / np.maximum(length, 1e-300)
        mean = group.mean / own
        white = mean / np.sqrt(1 / group.points + group.known / own**2)
        along, raw = along + ((white @ line) ** 2).sum(axis=0), raw + ((mean @ line) ** 2).sum(axis=0)
        whole, whole_raw = whole + float((white**2).sum()), whole_raw + float((mean**2).sum())
        count += group.left
    if not count or whole == 0.0:
        return None
    ratio = along / np.maximum((whole - along) / 2, 1e-300)
    joint = int(np.argmax(ratio))
    if f_tail(float(ratio[joint]), count, 2 * count) * len(ratio) >= CHANCE:
        return None
    excess = raw[joint] - (whole_raw - raw[joint]) / 2
    rms = stated * float(np.sqrt(np.mean(own**2) * max(excess, 0.0) / count))
    return None if rms < FINEST * stated else Jumps(joint, rms, float(along[joint]) / whole)


TINY = 1e-12  # of columns of length one: directions below it stay as they are


def scattered_covariance(extended: ExtendedLoadedModel) -> Float2D:
    """Return the (n, n) covariance of the compliances, (rad/(N*m))^2, each variance at least that of the scatter."""
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


def held_out_lengths(extended: ExtendedLoadedModel, cell: Cell, accepted: tuple[int, ...]) -> Float1D:
    """Return the lengths (k,) m of the prediction errors of the readings that count.

    Args:
        extended: The extended model, linear about its own compliances.
        cell: The cell file.
        accepted: The effects to predict with; none is the null model.
    """
    design, problem = extended.design, extended.problem
    whole, without = solutions(design, accepted)
    linear = problem.linearise(extended.base_compliance)
    raw = [linear.columns]
    raw += [design.candidates[i].columns(extended.state) * design.prior[design.blocks[i]] for i in accepted]
    columns = np.concatenate(raw, axis=2)
    values = np.stack([without.get(k, whole) for k in range(int(problem.configuration.max()) + 1)])
    error = linear.residual - np.einsum("mij,mj->mi", columns, values[problem.configuration])
    error = relative(problem, dataclasses.replace(linear, residual=error), cell, extended.used)
    return np.asarray(np.linalg.norm(error[counted(problem.readings, cell)], axis=1))
