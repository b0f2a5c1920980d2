"""What a recording, and measurements that are only imagined yet, tell about a hypothesis.

A hypothesis is a linear model y = X theta + noise of unit variance with a normal prior on theta; X holds the null
model, the effects that are not in question, the structured discrepancy and the effect in question.  The prediction of a
measurement not yet made is then normal, and so is the expected log Bayes factor between two hypotheses:

    D(h, g) = (tr(S_g^-1 S_h) - d + (m_g - m_h)' S_g^-1 (m_g - m_h) + log det S_g - log det S_h) / 2,

with mean m and covariance S of the predictions.  All parameters, those of the null model too, are refitted in it.
Source: Box and Hill 1967; Atkinson and Fedorov 1975 (T-optimality).
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from scipy.linalg import cholesky
from scipy.linalg.lapack import dtrtri

from calibration_core.timeseries import Float1D, Float2D, Float3D

FREE = 1e-9  # prior precision of the null model's columns, these being of length one
LEAST_SCALE = 1e-2  # of the longest of these: a shorter one counts as so long, one that no load has shown as any other


@dataclasses.dataclass(frozen=True, eq=False)
class Predictions:
    """Means (k, d) and covariances (k, d, d) of k measurements not yet made, noise included."""

    mean: Float2D
    covariance: Float3D


@dataclasses.dataclass(frozen=True, eq=False)
class HypothesisPosterior:
    """Posterior of one hypothesis.

    Attributes:
        scale: (p,) by which columns are divided.
        matrix: (p, p) posterior precision of the scaled parameters.
        vector: (p,) its product with the mean.
    """

    scale: Float1D
    matrix: Float2D
    vector: Float1D

    @staticmethod
    def of(columns: Float2D, residual: Float1D, free: int) -> HypothesisPosterior:
        """Learn from a recording.

        Args:
            columns: (r, p) whitened, the first `free` without a prior, the others per standard deviation of theirs.
            residual: (r,).
            free: How many have no prior.
        """
        return HypothesisPosterior.from_products(columns.T @ columns, columns.T @ residual, free)

    @staticmethod
    def from_products(matrix: Float2D, vector: Float1D, free: int) -> HypothesisPosterior:
        """Learn the same from the products of the columns with each other, (p, p), and with the residual, (p,)."""
        length = np.sqrt(np.diag(matrix))
        length[:free] = np.maximum(length[:free], LEAST_SCALE * length[:free].max(initial=0.0))
        scale = np.where(length > 0, length, 1.0)
        prior = 1 / scale**2
        prior[:free] = FREE
        return HypothesisPosterior(scale, matrix / np.outer(scale, scale) + np.diag(prior), vector / scale)

    @functools.cached_property
    def mean(self) -> Float1D:
        """(p,) in the units of the columns."""
        return np.asarray(self._root.T @ (self._root @ self.vector) / self.scale)

    @functools.cached_property
    def covariance(self) -> Float2D:
        """(p, p) in the units of the columns."""
        root = self._root / self.scale
        return np.asarray(root.T @ root)

    @functools.cached_property
    def _root(self) -> Float2D:
        """(p, p) R with R'R the inverse of the matrix."""
        return np.asarray(dtrtri(cholesky(self.matrix, lower=True), lower=True, overwrite_c=True)[0])

    def after(self, columns: Float2D, values: Float1D) -> HypothesisPosterior:
        """Return what is known after a measurement with these columns, (d, p), and values, (d,)."""
        scaled = columns / self.scale
        return HypothesisPosterior(self.scale, self.matrix + scaled.T @ scaled, self.vector + scaled.T @ values)

    def predict(self, columns: Float3D) -> Predictions:
        """Predict k measurements with columns (k, d, p)."""
        spread = self._spread(columns) @ columns.transpose(0, 2, 1)
        return Predictions(columns @ self.mean, spread + np.eye(columns.shape[1]))

    def variances_after(self, columns: Float3D, chosen: list[int]) -> Float2D:
        """Return (k, c) the variances of the chosen parameters after each of k measurements with columns (k, d, p)."""
        d, p = columns.shape[1:]
        if d > p:
            scaled = columns / self.scale
            known = self.matrix + scaled.transpose(0, 2, 1) @ scaled
            found = np.linalg.solve(known, np.eye(p)[:, chosen])
            return np.asarray(found[:, chosen, np.arange(len(chosen))] / self.scale[chosen] ** 2)
        spread = self._spread(columns)
        response = spread[:, :, chosen]  # (k, d, c)
        whole = spread @ columns.transpose(0, 2, 1) + np.eye(d)
        gained = np.einsum("kdc,kdc->kc", response, np.linalg.solve(whole, response))
        return np.asarray(np.diag(self.covariance)[chosen] - gained)

    def _spread(self, columns: Float3D) -> Float3D:
        """Return the columns, (k, d, p), times the covariance, in one product: one by one it would be read k times."""
        return np.asarray(columns.reshape(-1, columns.shape[2]) @ self.covariance).reshape(columns.shape)


def expected_log_bayes_factor(truth: Predictions, other: Predictions) -> Float1D:
    """Return (k,) nats by which each measurement is expected to favour the truth over the other hypothesis."""
    d = truth.mean.shape[1]
    inverse = np.linalg.inv(other.covariance)
    apart = other.mean - truth.mean
    _, log_other = np.linalg.slogdet(other.covariance)
    _, log_truth = np.linalg.slogdet(truth.covariance)
    trace = np.einsum("kij,kji->k", inverse, truth.covariance)
    distance = np.einsum("ki,kij,kj->k", apart, inverse, apart)
    return np.asarray(0.5 * (trace - d + distance + log_other - log_truth))
