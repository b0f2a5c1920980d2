"""Bayes factors of all candidates at once, inside a structured discrepancy.

Everything small is present a little.  The whole catalogue therefore enters the covariance,

    V = I + sum_l w_l^2 G_l G_l^T,

each place with the same signal-to-noise ratio c, and a finding must stand out from it.  c is found by restricted
maximum likelihood.  All quantities come from one Gram matrix, so that a thousand bootstrap samples cost nothing.
Source: Kass and Raftery 1995 (Bayes factors); Kennedy and O'Hagan 2001 with a physical kernel; Westfall and Young 1993
(distribution of the maximum).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.design import PRIOR_WIDTH, Design
from calibration_core.timeseries import Float1D, Float2D

LEVELS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
SAMPLES = 1000
FALSE_ALARM = 0.01
MOST = 1.0  # in typical sizes: how large the structured discrepancy may make any effect


@dataclasses.dataclass(frozen=True, eq=False)
class Field:
    """The Gram matrix in the metric of V at one level, and what was accepted so far.

    Attributes:
        design: The whitened model.
        weights: (p,) w of every column: amplitude of the discrepancy in prior standard deviations.
        level: c, signal-to-noise ratio of every place in the discrepancy.
        gram: Gram matrix of [null, columns, residual] in the metric of V^-1.
        accepted: Indices of accepted candidates; their columns are part of the null model.
    """

    design: Design
    weights: Float1D
    level: float
    gram: Float2D
    accepted: tuple[int, ...]


def field(design: Design, accepted: tuple[int, ...] = (), level: float | None = None) -> Field:
    """Set up the field; the level is found by restricted maximum likelihood unless given."""
    gram = design.gram()
    unit = _unit_weights(design, gram)
    if level is None:
        level = max(LEVELS, key=lambda c: (_likelihood(design, gram, unit, accepted, c), -c))
    weights = _weights(unit, level)
    return Field(design, weights, level, _metric(design, gram, weights)[0], accepted)


def log_bayes_factors(f: Field) -> Float1D:
    """Return the log Bayes factor of every candidate against the null model with what was accepted, (l,) nats."""
    schur = _without_null(f)
    return _scores(f.design, schur[:-1, :-1], schur[:-1, -1:])[:, 0]


def threshold(f: Field, seed: int = 0) -> float:
    """Return what the largest log Bayes factor exceeds in 1 % of recordings in which nothing more is missing."""
    schur = _without_null(f)[:-1, :-1]
    values, vectors = np.linalg.eigh(schur)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    noise = np.random.default_rng(seed).standard_normal((len(schur), SAMPLES))
    scores = _scores(f.design, schur, root @ noise)
    return float(np.quantile(scores.max(axis=0, initial=-np.inf), 1 - FALSE_ALARM)) if len(scores) else 0.0


def estimates(f: Field) -> tuple[Float1D, Float2D]:
    """Return values and covariance of null corrections and accepted parameters (their units), by GLS in V."""
    columns = _columns(f)
    matrix, vector = f.gram[np.ix_(columns, columns)], f.gram[columns, -1]
    n = f.design.n
    matrix = matrix + np.diag(np.concatenate([np.zeros(n), np.full(len(columns) - n, 1e-9)]))
    inverse = np.linalg.inv(matrix)
    unit = np.concatenate([np.ones(n), f.design.prior[[c - n for c in columns[n:]]]])
    return (inverse @ vector) * unit, np.asarray(inverse * np.outer(unit, unit), dtype=np.float64)


def posterior(f: Field, candidate: int) -> tuple[Float1D, Float2D]:
    """Return mean and covariance of one candidate's parameters (its units), beside the null and what was accepted."""
    schur = _without_null(f)
    block = f.design.blocks[candidate]
    matrix = schur[block, block] + np.eye(block.stop - block.start)
    inverse = np.linalg.inv(matrix)
    unit = f.design.prior[block]
    return (inverse @ schur[block, -1]) * unit, inverse * np.outer(unit, unit)


def signal_to_noise(design: Design) -> Float1D:
    """Return, per candidate, how visible its typical size is after the null model is refitted (dimensionless)."""
    gram = design.gram()
    schur = _schur(gram, list(range(design.n)))[:-1, :-1]
    return np.array([np.sqrt(max(float(np.trace(schur[b, b])), 0.0)) for b in design.blocks]) / PRIOR_WIDTH


def _unit_weights(design: Design, gram: Float2D) -> Float1D:
    """Return w per unit level: every place gets the same total signal-to-noise ratio, shared by its variants."""
    schur = _schur(gram, list(range(design.n)))
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


def _weights(unit: Float1D, level: float) -> Float1D:
    return np.minimum(level * unit, MOST / PRIOR_WIDTH)


def _metric(design: Design, gram: Float2D, weights: Float1D) -> tuple[Float2D, float]:
    """Return the Gram matrix in the metric of V^-1, and log det V (Woodbury)."""
    n = design.n
    inner = slice(n, n + len(weights))
    active = weights > 0
    if not active.any():
        return gram, 0.0
    scaled = gram[:, inner][:, active] * weights[active]
    core = np.eye(int(active.sum())) + scaled[inner][active] * weights[active][:, None]
    lower = np.linalg.cholesky(core)
    half = np.linalg.solve(lower, scaled.T)
    return gram - half.T @ half, 2 * float(np.log(np.diag(lower)).sum())


def _likelihood(design: Design, gram: Float2D, unit: Float1D, accepted: tuple[int, ...], level: float) -> float:
    metric, log_det = _metric(design, gram, _weights(unit, level))
    columns = _null_columns(design, accepted)
    matrix = metric[np.ix_(columns, columns)]
    rest = _schur(metric, columns)[-1, -1]
    return -0.5 * (float(rest) + log_det + float(np.linalg.slogdet(matrix)[1]))


def _null_columns(design: Design, accepted: tuple[int, ...]) -> list[int]:
    n = design.n
    extra = [n + c for index in accepted for c in range(design.blocks[index].start, design.blocks[index].stop)]
    return [*range(n), *extra]


def _columns(f: Field) -> list[int]:
    return _null_columns(f.design, f.accepted)


def _without_null(f: Field) -> Float2D:
    """Return the Gram matrix of [columns, residual] after the null model and what was accepted are projected out."""
    return _schur(f.gram, _columns(f))[f.design.n :, f.design.n :] if f.design.n else f.gram


def _schur(gram: Float2D, columns: list[int]) -> Float2D:
    """Project `columns` out of a Gram matrix; its shape stays, their rows become zero."""
    scale = np.sqrt(np.clip(np.diag(gram), 1e-300, None))[columns]
    cross = gram[columns] / scale[:, None]
    inner = gram[np.ix_(columns, columns)] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(inner)
    kept = values > 1e-10 * values[-1]
    half = (vectors[:, kept] / np.sqrt(values[kept])).T @ cross
    return gram - half.T @ half


def _scores(design: Design, schur: Float2D, vectors: Float2D) -> Float2D:
    """Return log Bayes factors (l, s) of all candidates for s right-hand sides."""
    result = np.empty((len(design.blocks), vectors.shape[1]))
    for index, block in enumerate(design.blocks):
        matrix = np.eye(block.stop - block.start) + schur[block, block]
        lower = np.linalg.cholesky(matrix)
        half = np.linalg.solve(lower, vectors[block])
        result[index] = 0.5 * (half**2).sum(axis=0) - np.log(np.diag(lower)).sum()
    return result
