"""An end effector that gives way: its stated compliance is taken off the readings as known (CWA 17384, 5.1)."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.identified.given import GivenModel
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float2D

TOOL_COMPLIANCE = "tool_compliance"


def accounted(cell: Cell, given: GivenModel | None) -> GivenModel | None:
    """Return the given model with the end effector that the cell file states; None where neither says anything.

    A model that has found a compliance of the tool itself keeps it.

    Raises:
        CellError: Neither a model nor the cell file says where the tracker is, so the directions are not known.
    """
    tool = cell.end_effector
    if (
        tool is None
        or not tool.states_stiffness
        or (given is not None and any(one.effect == TOOL_COMPLIANCE for one in given.parameters.effects))
    ):
        return given
    pairs = (("rotation", tool.rotation), ("translation", tool.translation))
    values = {f"{kind}_{axis}": value for kind, row in pairs for axis, value in zip("xyz", row, strict=True)}
    effect = AppliedEffect(TOOL_COMPLIANCE, {"tool": "tool"}, "six springs", values)
    if given is None:
        if cell.frames.tracker is None and cell.measurements.points == "absolute":
            raise cell.missing("frames.tracker", "taking off the end effector's compliance")
        parameters = nominal_parameters(cell)
        return GivenModel(parameters.replace(effects=(effect,)), str(cell.path), cell.sha256)
    changed = given.parameters.replace(effects=(*given.parameters.effects, effect))
    return GivenModel(changed, given.file, given.sha256, given.estimate)


def relative_stiffness(cell: Cell, q: Float2D) -> float:
    """Return how many times as stiff as the robot the stated end effector is, at the wrench point; NaN if unknown.

    Compared are the traces of the translational compliances, m/N, at the wrench point (at the flange without one):
    J C J^T of the joints, and what springs at the flange give.

    Args:
        cell: The cell, with its nominal stiffnesses.
        q: (m, n) rad, configurations that are measured.
    """
    tool, parameters = cell.end_effector, nominal_parameters(cell)
    if tool is None or not tool.states_stiffness or not np.any(parameters.compliance):
        return float("nan")
    point = np.zeros(3) if parameters.wrench_point is None else parameters.wrench_point
    at = posture(chain_of(cell), q)
    jacobian = linear_jacobian(at, at.point(point))  # (n, 3, m)
    robot = float(np.einsum("nam,n,nam->m", jacobian, parameters.compliance, jacobian).min())
    arms = np.cross(np.eye(3), point)  # motion of the point per unit rotation about each flange axis
    own = float(np.sum(tool.translation) + np.array(tool.rotation) @ np.sum(arms**2, axis=1))
    return robot / own if own > 0.0 else float("inf")
