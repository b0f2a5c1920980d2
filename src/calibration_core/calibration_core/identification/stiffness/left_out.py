"""Compliances with whole configurations left out: the honest way to test a prediction."""

from __future__ import annotations

import numpy as np

from calibration_core.identification.statistics.solve import solve_non_negative
from calibration_core.identification.stiffness.fit import LoadedFit
from calibration_core.timeseries import Float2D, Int1D

LEAVE_ONE_OUT = 200  # above this many configurations they are left out in groups
GROUPS = 20


def held_out_compliance(fit: LoadedFit, configuration: Int1D) -> Float2D:
    """Return, per configuration, the compliances fitted without it, (k, n) rad/(N*m).

    One Gauss-Newton step from the complete fit; the problem is linear up to K_CSM (a few tenths of a percent of the
    deflection), so the step lands on the fit of the rest to well below the noise.  Beyond 200 configurations they are
    left out in 20 interleaved groups.

    Args:
        fit: The complete fit.
        configuration: (m,) index of the configuration of every reading.
    """
    normal = fit.normal
    k = max(len(normal.matrix), int(configuration.max()) + 1)
    matrix, vector = normal.matrix.sum(axis=0), normal.vector.sum(axis=0)
    result = np.tile(fit.compliance, (k, 1))
    groups = np.arange(len(normal.matrix))
    if len(groups) > LEAVE_ONE_OUT:
        groups = groups % GROUPS
    for group in np.unique(groups):
        members = groups == group
        rest = matrix - normal.matrix[members].sum(axis=0)
        right = vector - normal.vector[members].sum(axis=0)
        solution = solve_non_negative(rest, right + rest @ fit.compliance, fit.compliance)
        result[np.flatnonzero(members)] = solution.value
    return result
