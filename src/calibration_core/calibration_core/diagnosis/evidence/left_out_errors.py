"""Every configuration predicted by the extended model fitted to the others, in metres."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.evidence.residual import solutions
from calibration_core.identification.stiffness.relative import counted, relative
from calibration_core.timeseries import Float1D


def held_out_lengths(extended: ExtendedLoadedModel, cell: Cell, accepted: tuple[int, ...]) -> Float1D:
    """Return the lengths (k,) m of the prediction errors of the readings that count.

    Args:
        extended: The extended model, linear about its own compliances.
        cell: The cell file.
        accepted: The effects to predict with; none is the null model.
    """
    design, problem = extended.design, extended.problem
    whole, without = solutions(design, accepted)
    linear = problem.linearise(extended.base_compliance)
    raw = [linear.columns]
    raw += [design.candidates[i].columns(extended.state) * design.prior[design.blocks[i]] for i in accepted]
    columns = np.concatenate(raw, axis=2)
    values = np.stack([without.get(k, whole) for k in range(int(problem.configuration.max()) + 1)])
    error = linear.residual - np.einsum("mij,mj->mi", columns, values[problem.configuration])
    error = relative(problem, dataclasses.replace(linear, residual=error), cell, extended.used)
    return np.asarray(np.linalg.norm(error[counted(problem.readings, cell)], axis=1))
