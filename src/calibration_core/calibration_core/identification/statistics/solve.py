"""From normal equations to compliances that are not negative, with their covariance."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Bool1D, Float1D, Float2D


def column_scale(matrix: Float2D) -> Float1D:
    """Return 1 over the length of every column, (p,), given J^T J; 1 for a column of zeros."""
    diagonal = np.diag(matrix)
    return 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def scaled_inverse(matrix: Float2D) -> Float2D:
    """Return the inverse of J^T J, (p, p).

    Raises:
        numpy.linalg.LinAlgError: It has none.
    """
    scale = column_scale(matrix)
    return np.asarray(np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale), dtype=np.float64)


SINGULAR = 1e-12  # eigenvalue of the column-scaled normal matrix, relative: condition number 1e6 of the columns


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """Compliances and how well the data determine them.

    Attributes:
        value: (n,) solution under x >= 0.
        unbounded: (n,) solution without the bound.
        covariance: (n, n) for unit weight, without the bound; infinite variance where undetermined.
        at_bound: (n,) whether the bound holds a parameter at zero.
        determined: (n,) whether the data say anything about a parameter.
        condition_number: Of the column-scaled observation matrix.
        eigenvalues: (n,) of the column-scaled normal matrix, ascending.
        eigenvectors: (n, n) their directions as columns, scaled parameters.
    """

    value: Float1D
    unbounded: Float1D
    covariance: Float2D
    at_bound: Bool1D
    determined: Bool1D
    condition_number: float
    eigenvalues: Float1D
    eigenvectors: Float2D


def solve_non_negative(matrix: Float2D, vector: Float1D, fallback: Float1D) -> Solution:
    """Solve min |A x - b| under x >= 0, given A^T A and A^T b.

    Columns are scaled to length one first, so that the outcome does not depend on units.  Directions in which the
    scaled matrix is singular keep the value of `fallback`.

    Args:
        matrix: (n, n) A^T A.
        vector: (n,) A^T b.
        fallback: (n,) values for what the data do not determine.
    """
    n = len(vector)
    norms = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
    loaded = norms > 1e-12 * norms.max(initial=0.0)
    scale = np.where(loaded, norms, 1.0)
    scaled = matrix / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > SINGULAR * max(float(values[-1]), 0.0)
    right = vector / scale - scaled @ (fallback * scale)
    weights = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    free = vectors @ (weights * (vectors.T @ right)) / scale + fallback
    lost = (vectors[:, ~kept] ** 2).sum(axis=1) > 1e-6
    bounded = _bounded(scaled, vector / scale, scale, np.where(loaded & ~lost, np.nan, fallback))
    inverse = (vectors * weights) @ vectors.T / np.outer(scale, scale)
    inverse[np.diag_indices(n)] = np.where(loaded & ~lost, np.diag(inverse), np.inf)
    smallest = float(values[0])
    condition = float(np.sqrt(values[-1] / smallest)) if smallest > 0 else float("inf")
    return Solution(
        bounded, free, inverse, loaded & ~lost & (bounded <= 0.0), loaded & ~lost, condition, values, vectors
    )


def _bounded(scaled: Float2D, vector: Float1D, scale: Float1D, fixed: Float1D) -> Float1D:
    """Solve the scaled problem for the entries of `fixed` that are NaN, the others held."""
    result = np.clip(fixed, 0.0, None)
    free = np.isnan(fixed)
    if not free.any():
        return result
    right = vector[free] - scaled[np.ix_(free, ~free)] @ (result[~free] * scale[~free])
    values, vectors = np.linalg.eigh(scaled[np.ix_(free, free)])
    root = np.sqrt(np.clip(values, 1e-300, None))
    solution = vectors @ ((vectors.T @ right) / root**2)
    if values[0] <= SINGULAR * values[-1] or (solution < 0).any():
        from scipy.optimize import nnls  # slow to load, and few recordings meet the bound

        solution, _ = nnls(root[:, None] * vectors.T, (vectors.T @ right) / root)
    result[free] = solution / scale[free]
    return result
