"""How strongly do absolute positions ask for each hypothesis, when the rest is not white?

What a model of absolute positions leaves out depends on posture, so the residuals of neighbouring poses go together and
a likelihood for independent readings is far too sure.  The estimate of a candidate's parameters therefore gets its
covariance from the scatter of whole blocks (sandwich), and the Bayes factor is that of the estimate under this
covariance against the physical prior.  The threshold is the 99 % quantile of the largest one over all candidates when
the signs of whole blocks of residuals are drawn at random: every dependence inside a block stays, the effect goes.
Source: Liang and Zeger 1986 (sandwich); Wakefield 2009 (Bayes factor of an estimate); Westfall and Young 1993 (the
maximum); Wu 1986 (random signs).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration_core.diagnosis.absolute_design import AbsoluteDesign
from calibration_core.diagnosis.blocks import Blocks
from calibration_core.timeseries import Float1D, Float2D, Float3D

LEAST_REST = 0.05  # share of a column's length that the model must leave
FLIPS = 100
BEST = 40  # candidates judged in full where the thresholds are known
FALSE_ALARM = 0.01
SEED = 17384
SPARE_BLOCKS = 3  # more than parameters
FLOOR = 0.02  # of the white covariance: keeps a sandwich of few blocks from vanishing
BATCH = 200  # candidates at a time
CHUNK = 10  # draws at a time
EULER = 0.5772156649015329
Float4D = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """Scores of all candidates beside the null model and what was accepted; -inf where one cannot be judged.

    Attributes:
        plain: (l,) log Bayes factor, nats, as if readings were independent with the residual's own variance: it ranks.
        robust: Partition -> (l,) log Bayes factor under the sandwich covariance: it decides.
        limit: Partition -> what the largest exceeds in 1 % of the cases without effect.
    """

    plain: Float1D
    robust: dict[str, Float1D]
    limit: dict[str, float]

    @property
    def passing(self) -> NDArray[np.bool_]:
        """(l,) whether a candidate exceeds the threshold in every partition."""
        return np.all([self.robust[kind] > limit for kind, limit in self.limit.items()], axis=0)

    def weakest(self, index: int) -> float:
        """Return the smaller log Bayes factor of a candidate over the partitions, nats."""
        return float(min(values[index] for values in self.robust.values()))


@dataclasses.dataclass(frozen=True, eq=False)
class Projected:
    """Residual and columns after the null model and what was accepted are projected out.

    Attributes:
        residual: (r,).
        columns: (r, p).
        judged: Candidates that can be judged.
    """

    residual: Float1D
    columns: Float2D
    judged: tuple[int, ...]


def project(design: AbsoluteDesign, accepted: Sequence[int]) -> Projected:
    """Project out the null model and the accepted candidates, and see which others remain distinguishable."""
    basis = orthonormal(design.of(accepted))
    residual = design.residual - basis @ (basis.T @ design.residual)
    columns = design.columns - basis @ (basis.T @ design.columns)
    length = np.einsum("ij,ij->j", design.columns, design.columns)
    left = np.einsum("ij,ij->j", columns, columns)
    clear = (length > 0) & (left > LEAST_REST**2 * length)
    open_blocks = [i for i, block in enumerate(design.blocks) if i not in accepted and bool(clear[block].all())]
    judged = [i for i in open_blocks if _sound(columns[:, design.blocks[i]], length[design.blocks[i]])]
    return Projected(residual, columns, tuple(judged))


def orthonormal(columns: Float2D) -> Float2D:
    """Return an orthonormal basis of the span of unit columns, directions below 1e-7 left out."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > 1e-7 * s[0]], dtype=np.float64)


def _sound(columns: Float2D, length: Float1D) -> bool:
    if columns.shape[1] == 1:
        return True
    gram = columns.T @ columns / np.sqrt(np.outer(length, length))
    return bool(np.linalg.eigvalsh(gram)[0] > LEAST_REST**2)


def evidence(
    design: AbsoluteDesign,
    accepted: Sequence[int],
    partitions: Sequence[Blocks],
    known: dict[str, float] | None = None,
    watched: int | None = None,
) -> Evidence:
    """Score every candidate.

    Args:
        design: The linear model.
        accepted: Candidates that are part of the model.
        partitions: Of the design's readings, into blocks.
        known: Thresholds found before, which hardly change from round to round; None to draw them.  With them only the
            candidates with the best plain evidence are judged in full, which is where time goes.
        watched: A candidate to be judged in any case.
    """
    at = project(design, accepted)
    count = len(design.candidates)
    variance = float(at.residual @ at.residual) / max(len(at.residual) - design.null.shape[1], 1)
    plain = np.full(count, -np.inf)
    for index in at.judged:
        own = at.columns[:, design.blocks[index]]
        plain[index] = _white(own.T @ own / variance, own.T @ at.residual / variance)
    judged = list(at.judged)
    if known is not None:
        best = sorted(judged, key=lambda i: (-plain[i], i))[:BEST]
        judged = sorted({*best, *(i for i in judged if i == watched)})
    robust: dict[str, Float1D] = {}
    limit: dict[str, float] = {}
    for partition in partitions:
        scores = np.full(count, -np.inf)
        largest = np.full(FLIPS, -np.inf)
        for members in _batches(design, judged):
            k = len(design.candidates[members[0]].parameters)
            if partition.count < k + SPARE_BLOCKS:
                continue
            flips = FLIPS if known is None else 0
            scores[members], flipped = _scores(design, at, members, partition, variance, flips)
            if flips:
                largest = np.maximum(largest, flipped.max(axis=1))
        robust[partition.kind] = scores
        limit[partition.kind] = _quantile(largest) if known is None else known[partition.kind]
    return Evidence(plain, robust, limit)


def _white(gram: Float2D, vector: Float1D) -> float:
    lower = np.linalg.cholesky(np.eye(len(vector)) + gram)
    half = np.linalg.solve(lower, vector)
    return float(0.5 * half @ half - np.log(np.diag(lower)).sum())


def _batches(design: AbsoluteDesign, judged: Sequence[int]) -> list[list[int]]:
    """Group candidates with the same number of parameters, not too many at a time."""
    sizes: dict[int, list[int]] = {}
    for index in judged:
        sizes.setdefault(len(design.candidates[index].parameters), []).append(index)
    return [group[k : k + BATCH] for group in sizes.values() for k in range(0, len(group), BATCH)]


def _scores(
    design: AbsoluteDesign, at: Projected, members: list[int], partition: Blocks, variance: float, flips: int
) -> tuple[Float1D, Float2D]:
    """Return the robust scores of some candidates, (c,), and with random signs, (f, c)."""
    label = np.repeat(partition.label, 3)
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(partition.count))
    own = np.stack([at.columns[order, design.blocks[index]] for index in members], axis=1)  # (r, c, k)
    score = np.add.reduceat(own * at.residual[order, None, None], starts, axis=0)  # (b, c, k)
    k = own.shape[2]
    gram = np.empty((partition.count, len(members), k, k))
    for i in range(k):
        for j in range(i, k):
            gram[:, :, i, j] = gram[:, :, j, i] = np.add.reduceat(own[:, :, i] * own[:, :, j], starts, axis=0)
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], (flips, partition.count))
    signs = np.vstack([np.ones(partition.count), signs])
    both = _bayes_factors(score, gram, signs, variance)
    return both[0], both[1:]


def _bayes_factors(score: Float3D, gram: Float4D, signs: Float2D, variance: float) -> Float2D:
    """Return log Bayes factors (f, c) for block scores (b, c, k), Gram matrices (b, c, k, k) and signs (f, b)."""
    blocks, candidates, k = score.shape
    total = gram.sum(axis=0)  # (c, k, k)
    inverse = _inverse(total)[0][:, None]  # (c, 1, k, k), for all signs of a candidate
    score = np.ascontiguousarray(score.transpose(1, 2, 0))  # (c, k, b)
    flat = gram.transpose(1, 2, 3, 0).reshape(candidates, k, k * blocks)  # (c, l, k b), symmetric in k and l
    result = np.empty((len(signs), candidates))
    for first in range(0, len(signs), CHUNK):
        sign = signs[first : first + CHUNK]
        f = len(sign)
        estimate = inverse @ (score @ sign.T).transpose(0, 2, 1)[..., None]  # (c, f, k, 1)
        fitted = (estimate[..., 0] @ flat).reshape(candidates, f, k, blocks)
        left = sign[:, None, :] * score[:, None] - fitted
        meat = left @ left.swapaxes(2, 3) * (blocks / (blocks - k)) + FLOOR * variance * total[:, None]
        covariance = inverse @ meat @ inverse
        narrow, log_narrow = _inverse(covariance)
        wide, log_wide = _inverse(covariance + np.eye(k))
        squares = (estimate.swapaxes(2, 3) @ ((narrow - wide) @ estimate))[..., 0, 0]
        result[first : first + CHUNK] = 0.5 * (squares + log_narrow - log_wide).T
    return result


def _inverse(matrix: Float4D) -> tuple[Float4D, Float2D]:
    """Return inverse and log determinant of positive matrices (..., k, k); small ones in closed form, for speed."""
    k = matrix.shape[-1]
    if k == 1:
        return 1.0 / matrix, np.log(matrix[..., 0, 0])
    if k == 2:
        determinant = matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] ** 2
        adjugate = np.empty_like(matrix)
        adjugate[..., 0, 0], adjugate[..., 1, 1] = matrix[..., 1, 1], matrix[..., 0, 0]
        adjugate[..., 0, 1] = adjugate[..., 1, 0] = -matrix[..., 0, 1]
        return adjugate / determinant[..., None, None], np.log(determinant)
    logarithm: Float2D = np.linalg.slogdet(matrix)[1]
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64), logarithm


def _quantile(largest: Float1D) -> float:
    """Return the 99 % quantile of maxima by a Gumbel distribution of their mean and variance."""
    if not np.isfinite(largest).all():
        return np.inf
    width = float(np.std(largest)) * np.sqrt(6) / np.pi
    return float(np.mean(largest) - EULER * width - width * np.log(-np.log(1 - FALSE_ALARM)))
