"""How much evidence the best of all candidates gathers by chance: the threshold that a finding must exceed.

A parametric bootstrap of the model in which nothing more is missing, from Gram matrices alone.
Source: Westfall and Young 1993 (distribution of the maximum).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpstrf

from calibration_core.diagnosis.evidence.bayes_factors import MarginalModel, log_bayes_factors_of
from calibration_core.timeseries import Float1D, Float2D

SAMPLES = 500  # of the bootstrap
FALSE_ALARM = 0.01  # share of them in which the best exceeds the threshold
ROUNDING = 1e-10  # of a column's square: what is left of it where it is rounding alone


def threshold(f: MarginalModel, freedom: int = 0, seed: int = 0) -> float:
    """Return what the largest log Bayes factor exceeds in 1 % of recordings in which nothing more is missing.

    Args:
        f: The model.
        freedom: Degrees of freedom on which the noise rests; its size is drawn anew in every sample.  0: it is known.
        seed: Of the bootstrap.
    """
    gram = f.schur[:-1, :-1]
    root = _root(gram, np.diag(f.cache.gram)[f.design.n : -1])
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((root.shape[1], SAMPLES))
    if freedom:
        noise /= np.sqrt(rng.chisquare(freedom, SAMPLES) / freedom)
    blocks = [gram[alike.columns[:, :, None], alike.columns[:, None, :]] for alike in f.cache.alike]
    scores = log_bayes_factors_of(f.cache.alike, blocks, root @ noise)
    return float(np.quantile(scores.max(axis=0, initial=-np.inf), 1 - FALSE_ALARM)) if len(scores) else 0.0


def _root(gram: Float2D, before: Float1D) -> Float2D:
    """Return a square root (p, r) of a Gram matrix (p, p), r its rank, by Cholesky's factorisation with pivots.

    Args:
        gram: What is left of the columns.
        before: (p,) their squares before anything was taken from them.
    """
    own = np.diag(gram)
    scale = np.sqrt(np.where(own > ROUNDING * before, own, 0.0))
    kept = np.flatnonzero(scale)
    if not len(kept):
        return np.zeros((len(gram), 0))
    correlation = gram[np.ix_(kept, kept)] / np.outer(scale[kept], scale[kept])
    lower, pivot, rank, _ = dpstrf(correlation, tol=ROUNDING, lower=True)
    root = np.zeros((len(gram), rank))
    root[kept[pivot - 1]] = scale[kept[pivot - 1], None] * np.tril(lower)[:, :rank]
    return root
