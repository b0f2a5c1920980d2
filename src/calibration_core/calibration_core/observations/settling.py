"""Whether a window has settled: does its mean still move, more than noise and by an amount that matters?"""

from __future__ import annotations

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Int1D

MIN_SAMPLES = 8
SIGNIFICANCE = 5.0  # standard errors
PARTS = (0.0, 0.25, 0.5)  # how much of the beginning may be given up


def settled_from(time: Int1D, values: Float2D, tolerance: Float1D) -> int | None:
    """Find the sample from which a window is settled.

    A part of the window is settled unless the straight line through it rises or falls by more than the tolerance in
    some component, and by more than five of its standard errors.

    Args:
        time: (n,) ns.
        values: (n, k).
        tolerance: (k,) change over the window that does not matter.

    Returns:
        Index of the first settled sample: 0, a quarter or half of the way; None if not even the second half is
        settled.  Fewer than eight samples are taken as they are.
    """
    for part in PARTS:
        begin = int(part * len(time))
        if len(time) - begin < MIN_SAMPLES:
            return 0 if part == 0.0 else None
        drift, error = line_drift(time[begin:], values[begin:])
        if not ((np.abs(drift) > tolerance) & (np.abs(drift) > SIGNIFICANCE * error)).any():
            return begin
    return None


def line_drift(time: Int1D, values: Float2D) -> tuple[Float1D, Float1D]:
    """Fit a straight line to samples (n, k) and return its change over the window and the standard error of that."""
    t = (time - time[0]).astype(np.float64)
    span = float(t[-1])
    if span <= 0.0:
        return np.zeros(values.shape[1]), np.zeros(values.shape[1])
    t = t / span - (t / span).mean()
    power = float(t @ t)
    centred = values - values.mean(axis=0)
    drift = t @ centred / power
    rest = centred - np.outer(t, drift)
    variance = (rest**2).sum(axis=0) / max(len(t) - 2, 1)
    return np.asarray(drift), np.asarray(np.sqrt(variance / power))
