"""Bayes factors of all candidates at once, inside a structured discrepancy.

Everything small is present a little.  The whole catalogue therefore enters the covariance,

    V = I + sum_l w_l^2 G_l G_l^T,

each place with the same signal-to-noise ratio c, and a finding must stand out from it.  c is not fixed beforehand: a
hypothesis is judged at the level that suits it best, against the null model at the level that suits that one best, so
that neither can a crowd of small effects pass for a large one, nor a large one raise the level and hide in the crowd.
The law of an accepted effect is known to some share only; candidates confounded with it enter the covariance with
that share of its size.
All quantities come from Gram matrices, so that a thousand bootstrap samples cost nothing.
Source: Kass and Raftery 1995 (Bayes factors); Kennedy and O'Hagan 2001 with a physical kernel; Westfall and Young 1993
(distribution of the maximum).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from calibration_core.diagnosis.evidence.confounding import are_confounded
from calibration_core.diagnosis.evidence.design import PRIOR_WIDTH, Design
from calibration_core.diagnosis.evidence.positive_share import log_positive
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D

NOISE_ALONE = (0.0,)  # where the noise is what the model leaves, small effects are part of it
LEVELS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.5)
MOST = 1.0  # in typical sizes: how large the structured discrepancy may make any effect
LAW = 0.15  # share to which the law of an effect is known


@dataclasses.dataclass(frozen=True, eq=False)
class Alike:
    """Candidates whose parameters are as many and as positive.

    Attributes:
        members: (c,) their indices.
        columns: (c, k) their columns.
        positive: (k,) which parameters physics lets not be negative.
    """

    members: Int1D
    columns: NDArray[np.int64]
    positive: Bool1D


@dataclasses.dataclass(frozen=True, eq=False)
class GramCache:
    """What all levels share.

    Attributes:
        design: The whitened model.
        gram: Gram matrix of [null, columns, residual].
        unit: (p,) amplitude of the discrepancy per unit of signal-to-noise ratio, in prior standard deviations.
        alike: Candidates of equal shape.
        shares: What `law_share` has returned, by what was accepted: the search comes back to the same sets.
        profiles: What `judge` has returned, likewise, and by the levels.
        suited: The level that suited the null model beside what was accepted best.
    """

    design: Design
    gram: Float2D
    unit: Float1D
    alike: tuple[Alike, ...]
    shares: dict[frozenset[int], Float1D] = dataclasses.field(default_factory=dict)
    profiles: dict[tuple[frozenset[int], tuple[float, ...]], Profile] = dataclasses.field(default_factory=dict)
    suited: dict[frozenset[int], float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class Profile:
    """All candidates beside what was accepted, each at the level that suits it best.

    Attributes:
        scores: (l,) log Bayes factors, nats.
        levels: (l,) the level that suits each.
        level: The level that suits the null model best.
    """

    scores: Float1D
    levels: Float1D
    level: float


@dataclasses.dataclass(frozen=True, eq=False)
class MarginalModel:
    """The linear model with its amplitudes integrated out, at one level, beside what is accepted: the metric of V.

    Attributes:
        cache: What all levels share.
        level: c, signal-to-noise ratio of every place in the discrepancy.
        accepted: Indices of accepted candidates; their columns are in V with their priors.
        weights: (p,) w of every column.
        taken: (n + p + 1, a) T, what the metric of V^-1 and the null model take from the Gram matrix G of
            [null, columns, residual]: G - T T^T is left.
        likelihood: Log marginal likelihood of the recording, nats, up to a constant.
    """

    cache: GramCache
    level: float
    accepted: tuple[int, ...]
    weights: Float1D
    taken: Float2D
    likelihood: float

    @property
    def design(self) -> Design:
        """The whitened model."""
        return self.cache.design

    @functools.cached_property
    def schur(self) -> Float2D:
        """(p + 1, p + 1) Gram matrix of [columns, residual] in the metric of V^-1, null model projected out."""
        own = self.taken[self.design.n :]
        return np.asarray(self.cache.gram[self.design.n :, self.design.n :] - own @ own.T)


def gram_cache(design: Design) -> GramCache:
    """Prepare a design."""
    gram = design.gram()
    return GramCache(design, gram, _unit_weights(design, gram), _alike(design))


def marginal_model(
    cache: GramCache, accepted: tuple[int, ...], level: float, law_errors: Float1D | None = None
) -> MarginalModel:
    """Set up the model at one level.

    Args:
        cache: The prepared design.
        accepted: Candidates in the model.
        level: c.
        law_errors: (p,) signal-to-noise ratio that each column's place has from the error of accepted laws; None: none.
    """
    design = cache.design
    each = np.full(len(cache.unit), level) if law_errors is None else np.maximum(level, law_errors)
    weights = np.minimum(each * cache.unit, MOST / PRIOR_WIDTH)
    for index in accepted:
        weights[design.blocks[index]] = 1.0
        weights[design.chances[index]] = 1.0
    weights[design.discrepancy] = 1.0
    half, log_det = _half(design, cache.gram, weights)
    n = design.n
    null = cache.gram[:n] - half[:n] @ half.T
    taken = np.concatenate([half, _projected(null, list(range(n)))], axis=1)
    _, log_null = np.linalg.slogdet(null[:, :n])
    left = float(cache.gram[-1, -1] - taken[-1] @ taken[-1])
    return MarginalModel(cache, level, accepted, weights, taken, -0.5 * (left + log_det + float(log_null)))


def without_confounded(f: MarginalModel, candidate: int) -> MarginalModel:
    """Return the model whose discrepancy knows nothing of a candidate and what is confounded with it."""
    design = f.design
    weights = f.weights.copy()
    for index, other in enumerate(design.candidates):
        if index not in f.accepted and are_confounded(design.candidates[candidate], other, design.joints):
            weights[design.blocks[index]] = 0.0
    return dataclasses.replace(f, weights=weights)


def most_probable(several: tuple[MarginalModel, ...]) -> MarginalModel:
    """Return the model at the level at which the recording is most probable."""
    return max(several, key=lambda f: (f.likelihood, -f.level))


def profile(several: tuple[MarginalModel, ...]) -> tuple[Float1D, Float1D]:
    """Judge every candidate at the level that suits it best against the null model at the level that suits that best.

    Returns:
        scores: (l,) log Bayes factors, nats.
        levels: (l,) index of the level that suits each.
    """
    totals = np.stack([f.likelihood + log_bayes_factors(f) for f in several])
    return totals.max(axis=0) - most_probable(several).likelihood, totals.argmax(axis=0)


def judge(cache: GramCache, accepted: tuple[int, ...], levels: tuple[float, ...] = LEVELS) -> Profile:
    """Return the profile beside what was accepted, the law of the accepted ones known to a share."""
    key = frozenset(accepted), levels
    if key not in cache.profiles:
        several = _suitable(cache, accepted, levels)
        scores, at = profile(several)
        cache.profiles[key] = Profile(scores, np.array(levels)[at], most_probable(several).level)
    return cache.profiles[key]


def at_its_level(cache: GramCache, accepted: tuple[int, ...], levels: tuple[float, ...] = LEVELS) -> MarginalModel:
    """Return the model of what was accepted at the level at which the recording is most probable with it.

    The likelihoods of several compare what was accepted in each (Kass and Raftery 1995).
    """
    return most_probable(_suitable(cache, accepted, levels))


def _suitable(cache: GramCache, accepted: tuple[int, ...], levels: tuple[float, ...]) -> tuple[MarginalModel, ...]:
    """Set up the models at the levels up to one above the level that suits best.

    What is accepted explains, so that fewer small effects are left than beside a part of it: the search for the level
    begins at the least level that suited a part.
    """
    own, share = frozenset(accepted), law_share(cache, accepted)
    start = min((level for part, level in cache.suited.items() if part <= own), default=levels[-1])
    several: list[MarginalModel] = []
    for level in levels:
        if level > start and several and most_probable(tuple(several)).level < several[-1].level:
            break
        several.append(marginal_model(cache, accepted, level, share))
    cache.suited[own] = most_probable(tuple(several)).level
    return tuple(several)


def log_bayes_factors(f: MarginalModel) -> Float1D:
    """Return the log Bayes factor of every candidate beside what was accepted, at the model's level, (l,) nats."""
    gram, n = f.cache.gram, f.design.n
    blocks = []
    for alike in f.cache.alike:
        columns = n + alike.columns
        own = f.taken[columns]
        blocks.append(gram[columns[:, :, None], columns[:, None, :]] - own @ own.transpose(0, 2, 1))
    vectors = gram[n:-1, -1:] - f.taken[n:-1] @ f.taken[-1:].T
    return log_bayes_factors_of(f.cache.alike, blocks, vectors)[:, 0]


def chance_alone(f: MarginalModel, candidate: int) -> float:
    """Return the log Bayes factor of what a candidate leaves to chance, without the candidate's parameters, nats."""
    block = f.design.chances[candidate]
    matrix = f.schur[block, block] + np.eye(block.stop - block.start)
    vector = f.schur[block, -1]
    return float(0.5 * (vector @ np.linalg.solve(matrix, vector) - np.linalg.slogdet(matrix)[1]))


def posterior(f: MarginalModel, candidate: int) -> tuple[Float1D, Float2D]:
    """Return mean and covariance of one candidate's parameters (its units), beside the null and what was accepted."""
    block = f.design.blocks[candidate]
    inverse = np.linalg.inv(f.schur[block, block] + np.eye(block.stop - block.start))
    unit = f.design.prior[block]
    return (inverse @ f.schur[block, -1]) * unit, inverse * np.outer(unit, unit)


def visible_size(f: MarginalModel, candidate: int) -> float:
    """Return the signal-to-noise ratio of a candidate's fitted effect that the null model cannot take over."""
    block = f.design.blocks[candidate]
    mean = posterior(f, candidate)[0] / f.design.prior[block]
    return float(np.sqrt(max(float(mean @ f.schur[block, block] @ mean), 0.0)))


def law_share(cache: GramCache, accepted: tuple[int, ...]) -> Float1D:
    """Return the (p,) signal-to-noise ratio that accepted effects lend to places confounded with theirs."""
    if frozenset(accepted) in cache.shares:
        return cache.shares[frozenset(accepted)]
    design = cache.design
    share = np.zeros(len(cache.unit))
    for position, index in enumerate(accepted):
        others = accepted[:position] + accepted[position + 1 :]
        size = LAW * visible_size(marginal_model(cache, others, 0.0), index)
        for other, candidate in enumerate(design.candidates):
            if are_confounded(design.candidates[index], candidate, design.joints):
                block = design.blocks[other]
                share[block] = np.maximum(share[block], size)
    cache.shares[frozenset(accepted)] = share
    return share


def estimates(f: MarginalModel) -> tuple[Float1D, Float2D]:
    """Return values and covariance of null corrections and accepted parameters (their units), by GLS in V.

    Accepted parameters keep their (wide) priors.
    """
    design = f.design
    n = design.n
    own = [c for index in f.accepted for c in range(design.blocks[index].start, design.blocks[index].stop)]
    weights = f.weights.copy()
    weights[own] = 0.0
    half, _ = _half(design, f.cache.gram, weights)
    columns = [*range(n), *(n + c for c in own)]
    metric = f.cache.gram[columns] - half[columns] @ half.T
    matrix = metric[:, columns] + np.diag(np.concatenate([np.zeros(n), np.ones(len(own))]))
    scale = np.sqrt(np.clip(np.diag(matrix), 1e-300, None))
    inverse = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    unit = np.concatenate([np.ones(n), design.prior[own]])
    return (inverse @ metric[:, -1]) * unit, np.asarray(inverse * np.outer(unit, unit), dtype=np.float64)


def _unit_weights(design: Design, gram: Float2D) -> Float1D:
    """Return w per unit level: every place gets the same total signal-to-noise ratio, shared by its variants."""
    schur = _schur(gram, list(range(design.n)))[design.n : -1, design.n : -1]
    places: dict[object, list[int]] = {}
    for index, candidate in enumerate(design.candidates):
        places.setdefault(candidate.place, []).append(index)
    weights = np.zeros(len(design.prior))
    for members in places.values():
        for index in members:
            block = design.blocks[index]
            power = float(np.trace(schur[block, block])) * len(members)
            weights[block] = 1 / np.sqrt(power) if power > 0 else 0.0
    return weights


def _half(design: Design, gram: Float2D, weights: Float1D) -> tuple[Float2D, float]:
    """Return H (n + p + 1, a) with G - H H^T the Gram matrix in the metric of V^-1, and log det V (Woodbury)."""
    n = design.n
    active = np.flatnonzero(weights > 0)
    scaled = gram[:, n + active] * weights[active]
    core = np.eye(len(active)) + scaled[n + active] * weights[active][:, None]
    lower = np.linalg.cholesky(core)
    half = solve_triangular(lower, scaled.T, lower=True, check_finite=False) if len(active) else scaled.T
    return half.T, 2 * float(np.log(np.diag(lower)).sum())


def _schur(gram: Float2D, columns: list[int]) -> Float2D:
    """Project `columns` out of a Gram matrix; its shape stays, their rows become zero."""
    half = _projected(gram[columns], columns)
    return gram - half @ half.T


def _projected(rows: Float2D, columns: list[int]) -> Float2D:
    """Return H (p, k) with H H^T what the projection onto `columns` takes from a Gram matrix with these rows of it."""
    if not columns:
        return np.zeros((rows.shape[1], 0))
    scale = np.sqrt(np.clip(np.diag(rows[:, columns]), 1e-300, None))
    cross = rows / scale[:, None]
    inner = rows[:, columns] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(inner)
    kept = values > 1e-10 * values[-1]
    return np.asarray(cross.T @ (vectors[:, kept] / np.sqrt(values[kept])))


def log_bayes_factors_of(several: Sequence[Alike], blocks: Sequence[Float3D], vectors: Float2D) -> Float2D:
    """Return log Bayes factors (l, s) of all candidates for s right-hand sides.

    Where physics allows positive values only the prior is one half of the normal per parameter; by what share of the
    two-sided posterior is positive in all of them the factor changes.

    Args:
        several: Candidates of equal shape together.
        blocks: For each of them the (c, k, k) Gram matrices of their members.
        vectors: (p, s).
    """
    result = np.empty((sum(len(alike.members) for alike in several), vectors.shape[1]))
    for alike, block in zip(several, blocks, strict=True):
        lower = np.linalg.cholesky(np.eye(block.shape[1]) + block)
        half = np.linalg.solve(lower, vectors[alike.columns])
        log_det = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        result[alike.members] = 0.5 * (half**2).sum(axis=1) - log_det[:, None]
        if alike.positive.any():
            across = np.linalg.inv(lower).transpose(0, 2, 1)[:, alike.positive]
            share = log_positive(across @ half, across @ across.transpose(0, 2, 1))
            result[alike.members] += alike.positive.sum() * np.log(2) + share
    return result


def _alike(design: Design) -> tuple[Alike, ...]:
    """Group candidates of equal shape."""
    shapes: dict[bytes, list[int]] = {}
    own = [design.own(index) for index in range(len(design.blocks))]
    for index, columns in enumerate(own):
        shapes.setdefault(design.positive[columns].tobytes(), []).append(index)
    return tuple(
        Alike(np.array(members), np.array([own[i] for i in members]), design.positive[own[members[0]]])
        for members in shapes.values()
    )
