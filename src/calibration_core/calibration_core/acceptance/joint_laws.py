"""Backlash and hysteresis of every joint, measured beside its stiffness: reducers lose motion before stiffness.

Both are estimated with all compliances refitted, each for itself and without a prior, from the same law in every
recording, so that two recordings can be compared whether a diagnosis would name the law or not.  Backlash is the
clearance of a joint that crosses it within 2 % of its largest torque; hysteresis the half width of elements that stick
up to 6 and 15 % of it.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.statistics import normal_equations
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.effects.joint_law.hysteresis import stop
from calibration_core.model.effects.state import State, recorded_state
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.timeseries import Float1D, Float3D, Readings

CLEARANCE = 0.02  # of the largest torque: within it a joint crosses its clearance
RADII = (0.06, 0.15)  # of the largest torque: elements that stick so far
VIRGIN = 0.0  # what an element carries at step 0: nothing
LEAST_INFORMATION = 1e-6  # share of a column that the compliances leave: below, nothing is known of the law


def reference_torques(readings: Readings, cell: Cell, parameters: ModelParameters) -> Float1D:
    """Return the (n,) largest torques of the external load on the joints, N*m."""
    return np.abs(_state(readings, cell, parameters).load_torque).max(axis=1)


def joint_laws(
    readings: Readings, cell: Cell, parameters: ModelParameters, reference: Float1D, scale: float
) -> GaussianEstimate:
    """Return `backlash.JOINT` and `hysteresis.JOINT`, rad, each for itself; none where the joint cannot show it.

    Args:
        readings: A loaded recording.
        cell: The cell.
        parameters: What was identified from it; its effects are not used.
        reference: (n,) N*m, the torques that the laws refer to: the same for all recordings that are compared.
        scale: Factor on the stated noise, after the noise audit.

    Raises:
        CellError: A frame that the wrench needs is missing.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    state = _state(readings, cell, parameters)
    problem = build_problem(readings, cell, state.chain, parameters)
    linear = problem.linearise(parameters.compliance)
    names, columns = _columns(state, reference)
    n = state.chain.n
    normal = normal_equations(linear.rows, linear.residual, np.concatenate([linear.columns, columns], axis=2))
    matrix, vector = normal.matrix.sum(axis=0), normal.vector.sum(axis=0)
    kept, values, variances = [], [], []
    for k, name in enumerate(names):
        rows = [*range(n), n + k]
        gram, target = matrix[np.ix_(rows, rows)], vector[rows]
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inverse = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-10)
        if gram[n, n] <= 0 or inverse[n, n] > 1 / LEAST_INFORMATION:
            continue
        kept.append(name)
        values.append(float((inverse @ (target / size))[n] / size[n]))
        variances.append(scale**2 * inverse[n, n] / size[n] ** 2)
    return GaussianEstimate(
        tuple(name for name, _ in kept), tuple(unit for _, unit in kept), np.array(values), np.diag(variances)
    )


def _columns(state: State, reference: Float1D) -> tuple[list[tuple[str, str]], Float3D]:
    names, columns = [], []
    for joint, name in enumerate(state.chain.joints):
        if not state.bears_load(joint) or reference[joint] <= 0:
            continue
        unit = state.chain.units[joint]
        crossed = np.clip(state.load_torque[joint] / (CLEARANCE * reference[joint]), -1.0, 1.0) / 2
        names.append((f"backlash.{name}", unit))
        columns.append(state.joint_column(joint, crossed))
        stuck = np.zeros(state.m)
        for share in RADII:
            radius = share * float(reference[joint])
            friction = state.along_steps(state.torque[joint], partial(stop, radius=radius, start=VIRGIN))
            stuck -= friction / radius
        names.append((f"hysteresis.{name}", unit))
        columns.append(state.joint_column(joint, stuck / len(RADII)))
    if not columns:
        return [], np.zeros((state.m, 3, 0))
    return names, np.stack(columns, axis=-1)


def _state(readings: Readings, cell: Cell, parameters: ModelParameters) -> State:
    chain = chain_of(cell).corrected(parameters.geometry)
    return recorded_state(readings, cell, chain, parameters, load_of(readings, cell, parameters))
