"""Root mean squares: the sizes in which residuals, shifts and noise are stated."""

from __future__ import annotations

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Float3D


def rms(values: Float1D | Float2D | Float3D) -> float:
    """Return the root mean square over all values, for example per coordinate."""
    return float(np.sqrt(np.mean(values**2)))


def rms_length(vectors: Float2D) -> float:
    """Return the root mean square of the lengths of (m, 3) vectors."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
