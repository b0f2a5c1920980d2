"""Normal matrices J^T J with all columns of J at length one, so that nothing depends on their units."""

from __future__ import annotations

import numpy as np

from calibration_core.timeseries import Float1D, Float2D


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
