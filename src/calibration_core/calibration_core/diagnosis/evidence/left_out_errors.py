"""Every configuration predicted by the extended model fitted to the others, in metres."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.evidence.residual import solutions
from calibration_core.identification.statistics.offsets import without_offsets
from calibration_core.timeseries import Bool1D, Float1D, Float2D

SET_ASIDE = 1e12  # factor on the variance of a reading that is not used, so that offsets do not depend on it


def held_out_errors(
    extended: ExtendedLoadedModel, accepted: tuple[int, ...], *, displacement: bool
) -> tuple[Float2D, Bool1D]:
    """Return prediction errors (m, 3) m of all readings, and which of them count, (m,).

    Args:
        extended: The extended model, linear about its own compliances.
        accepted: The effects to predict with; none is the null model.
        displacement: Whether readings are differences to step 0, which then is zero and does not count; otherwise the
            best offsets are removed.
    """
    design, problem, used = extended.design, extended.problem, extended.used
    whole, without = solutions(design, accepted)
    linear = problem.linearise(extended.base_compliance)
    raw = [linear.columns]
    raw += [design.candidates[i].columns(extended.state) * design.prior[design.blocks[i]] for i in accepted]
    columns = np.concatenate(raw, axis=2)
    values = np.stack([without.get(k, whole) for k in range(int(problem.configuration.max()) + 1)])
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
