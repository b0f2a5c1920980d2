"""The extended model on a recording that was not fitted: only the offsets of its configurations are free."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.evidence.extended import loaded_state
from calibration_core.identification.result.estimate import TestResult
from calibration_core.identification.statistics.offsets import without_offsets
from calibration_core.identification.stiffness.loaded import predict_loaded
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.chain import Chain
from calibration_core.model.effects.applied import applied_shift
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Readings


def tested_on(readings: Readings, cell: Cell, chain: Chain, null: Float1D, model: ModelParameters) -> TestResult:
    """Predict a second recording with the extended model, beside the null model.

    Args:
        readings: The other recording.
        cell: The cell file.
        chain: The robot.
        null: (n,) compliances of the null model, rad/(N*m).
        model: The extended model.

    Raises:
        IdentificationError: The recording holds no loaded steps.
    """
    compared = predict_loaded(readings, cell, chain, model, null)
    problem = build_problem(readings, cell, chain, model)
    linear = problem.linearise(model.compliance)
    moved = applied_shift(model.effects, loaded_state(problem, cell, model.compliance))
    rest = without_offsets(linear.rows, linear.residual - moved)
    lengths = np.linalg.norm(rest, axis=1)
    return dataclasses.replace(
        compared,
        rms=float(np.sqrt(np.mean(rest**2))),
        mean=float(lengths.mean()),
        maximum=float(lengths.max()),
    )
