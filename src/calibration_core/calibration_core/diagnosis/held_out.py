"""Every configuration predicted by the extended model fitted to the others, in metres."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.extended import Extended
from calibration_core.identification.offsets import without_offsets
from calibration_core.timeseries import Bool1D, Float1D, Float2D

SET_ASIDE = 1e12  # factor on the variance of a reading that is not used, so that offsets do not depend on it


def held_out_errors(extended: Extended, accepted: tuple[int, ...], *, displacement: bool) -> tuple[Float2D, Bool1D]:
    """Return prediction errors (m, 3) m of all readings, and which of them count, (m,).

    Args:
        extended: The extended model, linear about its own compliances.
        accepted: The effects to predict with; none is the null model.
        displacement: Whether readings are differences to step 0, which then is zero and does not count; otherwise the
            best offsets are removed.
    """
    design, problem, used = extended.design, extended.problem, extended.used
    n = design.n
    white = np.column_stack([design.null, *(design.columns[:, design.blocks[i]] for i in accepted)])
    scale = np.linalg.norm(white, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    ridge = np.full(white.shape[1], 1e-9)
    ridge[n:] = 1 / scale[n:] ** 2  # the accepted keep their priors
    white = white / scale
    matrix, vector = white.T @ white + np.diag(ridge), white.T @ design.residual
    linear = problem.linearise(extended.base_compliance)
    raw = [linear.columns]
    raw += [design.candidates[i].columns(extended.state) * design.prior[design.blocks[i]] for i in accepted]
    columns = np.concatenate(raw, axis=2) / scale
    values = np.tile(np.linalg.solve(matrix, vector), (int(problem.configuration.max()) + 1, 1))
    for number in np.unique(design.configuration):
        rows = design.configuration == number
        own = white[rows]
        values[number] = np.linalg.solve(matrix - own.T @ own, vector - own.T @ design.residual[rows])
    error = linear.residual - np.einsum("mij,mj->mi", columns, values[problem.configuration])
    if displacement:
        return extended.state.since_step_zero(error), extended.state.since_step_zero(
            problem.readings.step[:, None].astype(float)
        )[:, 0] > 0
    aside = np.ones(len(error), dtype=bool)
    aside[used] = False
    noise = linear.rows.noise * np.where(aside, SET_ASIDE, 1.0)[:, None, None]
    return without_offsets(dataclasses.replace(linear.rows, noise=noise), error), np.ones(len(error), dtype=bool)


def lengths(error: Float2D, counts: Bool1D) -> Float1D:
    """Return the lengths (k,) m of the errors that count."""
    return np.asarray(np.linalg.norm(error[counts], axis=1))
