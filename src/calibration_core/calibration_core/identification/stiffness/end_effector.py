"""An end effector that gives way: its stated compliance is taken off the readings as known (CWA 17384, 5.1).

What is known already is taken off the readings, so that only the rest is left to be explained.

The effects of a given model move the points by so much at its own compliances, geometry and frames; readings less this
movement are those of a robot without the effects.  Their parameters are taken as they stand, without
uncertainty.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import ModelFileError
from calibration_core.identification.stiffness.predict import (
    from_step_zero,
    predict_readings,
    require_points,
    shift_by_effects,
)
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float2D, Note, Readings

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


# --- what is known already is taken off the readings, so that only the rest is left to be explained -------------------


ANOTHER = 3.0  # times: so much nearer are the positions to the cell file's frames where the model is of another set-up


def in_own_set_up(given: GivenModel, readings: Readings, cell: Cell) -> GivenModel:
    """Return a given model of the robot in the set-up of a recording: with the cell file's frames, if they are meant.

    A model file has tracker, points and sensor as they stood when it was made.  Where they were set up anew since, the
    cell file says where they stand, and the recording is clearly nearer to that; else those of the model are better.

    Raises:
        EquilibriumError: The load is beyond what the joints of the model can carry.
    """
    model, nominal = given.start, nominal_parameters(cell)
    if cell.frames.tracker is None or not set(readings.points) <= set(model.points):
        return given
    frames = {name: getattr(nominal, name) for name in ("tracker", "points", "wrench_point", "force_torque")}
    own = model.replace(**frames)
    if _distance(readings, cell, model) <= ANOTHER * _distance(readings, cell, own):
        return given
    return dataclasses.replace(given, parameters=given.parameters.replace(**frames))


def _distance(readings: Readings, cell: Cell, model: ModelParameters) -> float:
    """Return how far readings are from what a model predicts, rms per coordinate, m."""
    return float(np.sqrt(np.mean((readings.position - predict_readings(readings, cell, model)) ** 2)))


def without_effects(readings: Readings, cell: Cell, given: GivenModel) -> Readings:
    """Return the readings less what the effects of a given model move the points, with a note that says so.

    Raises:
        RecordingError: The recording has a point that the model does not know.
        ModelFileError: The model contains an effect that this recording has no data for.
        EquilibriumError: The load is beyond what the joints of the model can carry.
    """
    model = given.parameters
    require_points(readings, model)
    if not model.effects:
        return readings
    try:
        shift = shift_by_effects(readings, cell, model) @ model.tracker[:3, :3]
    except ModelFileError as error:
        raise ModelFileError(given.file, error.place, error.found, error.expected) from None
    if cell.measurements.points == "displacement":
        shift = from_step_zero(readings, shift)
    text = f"the effects of this model were taken off the readings as known: {given.known_effects()}"
    note = Note("known_effects", given.file, text, len(readings))
    return dataclasses.replace(readings, position=readings.position - shift).with_notes(note)
