"""A model on a recording that was not fitted, each part of it judged by what it can show.

Configurations with several steps show differences under load: the free offset of every configuration and point takes up
geometry and frames.  Postures with one step show positions: tracker pose and targets are set-up and no property of the
robot, so that they are fitted to the test recording itself.  Where the fitted recording shows positions at rest, too,
its frames are part of what it says: the figures of the whole test recording are then with these, and nothing is fitted,
unless they stand elsewhere in the test recording.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.geometry.fit import (
    AbsoluteProblem,
    fit,
    problem_of,
    require_positions,
    start_parameters,
)
from calibration_core.identification.geometry.identifiability import select_frames
from calibration_core.identification.result.tested import PartKind, TestPart, TestResult
from calibration_core.identification.statistics import rms, without_offsets
from calibration_core.identification.stiffness.predict import require_points, shift_by_effects
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.timeseries import Bool1D, Float2D, Readings

Models = tuple[ModelParameters, ModelParameters]
ALIKE = 0.1  # times the noise: a smaller difference between two predictions is none
ROUNDS = 3
ELSEWHERE = 3.0  # times: so much smaller is the error once the set-up is fitted, where tracker or targets have moved


def tested_on(
    readings: Readings, cell: Cell, model: ModelParameters, before: ModelParameters, *, with_frames: bool
) -> TestResult:
    """Predict a recording that was not fitted with a model, and with the one that it is compared with.

    Args:
        readings: The other recording, of any kind.
        cell: The cell file.
        model: The identified or extended model.
        before: What it is compared with, with frames of its own.
        with_frames: Whether the figures of the whole recording judge the frames of the models, too; those of its
            postures at rest as a part never do.

    Raises:
        IdentificationError: The recording shows neither differences under load nor positions.
        RecordingError: It has a point that the model does not know.
        CellError: A frame that its wrench needs is missing.
        ModelFileError: The model contains an effect that the recording has no data for.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    require_points(readings, model)
    if readings.wrench is not None and not np.any(readings.wrench):
        readings = dataclasses.replace(readings, wrench=None)
    loaded = _with_several_steps(readings)
    if not loaded.any():
        require_positions(readings, cell)
    parts, left, elsewhere = [], [], False
    if loaded.any():
        part, *errors = _differences(readings, loaded, cell, (model, before))
        parts, left = [part], [errors]
    if not loaded.all():
        part, elsewhere, *errors = _positions(readings, ~loaded, cell, (model, before), with_frames)
        parts, left = [*parts, part], [*left, errors]
    after, nominal = (np.concatenate(both) for both in zip(*left, strict=True))
    return TestResult.of(readings, parts, after, nominal, own_frames=elsewhere)


def _with_several_steps(readings: Readings) -> Bool1D:
    """Return (m,) which readings are of configurations with several steps, where a load is known."""
    if readings.wrench is None:
        return np.zeros(len(readings), dtype=bool)
    numbers, group = np.unique(readings.configuration, return_inverse=True)
    group = group.reshape(-1)
    pairs = np.unique(np.column_stack([group, readings.step]), axis=0)
    return np.asarray(np.bincount(pairs[:, 0], minlength=len(numbers))[group] > 1)


def _differences(readings: Readings, rows: Bool1D, cell: Cell, models: Models) -> tuple[TestPart, Float2D, Float2D]:
    """Judge differences under load; what both models leave of them, (m, 3) m each, is in the frames of the first."""
    part = readings.select(rows)

    def left(parameters: ModelParameters) -> Float2D:
        problem = build_problem(part, cell, chain_of(cell).corrected(parameters.geometry), parameters)
        linear = problem.linearise(parameters.compliance)
        shift = shift_by_effects(readings, cell, parameters)[rows]  # laws with a memory need the whole recording
        return without_offsets(linear.rows, linear.residual - shift)

    model, before = models
    frames = {name: getattr(model, name) for name in ("tracker", "points", "setups", "wrench_point", "force_torque")}
    after, nominal = left(model), left(before.replace(**frames))
    return _judged("loaded", part, cell, after, nominal), after, nominal


def _positions(
    readings: Readings, rows: Bool1D, cell: Cell, models: Models, with_frames: bool
) -> tuple[TestPart, bool, Float2D, Float2D]:
    """Judge positions at rest, and say whether their frames stand elsewhere; what both models leave, (m, 3) m each."""
    part = readings.select(rows)
    count = len(np.unique(part.configuration))
    if cell.measurements.points == "displacement":
        reason = "one step alone shows nothing where positions are displacements from step 0"
        return TestPart.without_figures("at_rest", count, len(part), reason), False, np.zeros((0, 3)), np.zeros((0, 3))
    problem = problem_of(part, cell, chain_of(cell), models[0], position_covariance(part, cell))
    shifts = [shift_by_effects(readings, cell, one)[rows] for one in models]
    own = [problem.residual(one).T - shift for one, shift in zip(models, shifts, strict=True)]
    try:
        require_positions(part, cell)
    except IdentificationError as error:
        reason = f"tracker pose and targets cannot be fitted to them: found {error.found}, expected {error.expected}"
        left = own if with_frames else [np.zeros((0, 3))] * 2
        return TestPart.without_figures("at_rest", count, len(part), reason), False, left[0], left[1]
    fitted = [_with_set_up(problem, one, shift) for one, shift in zip(models, shifts, strict=True)]
    judged = _judged("at_rest", part, cell, fitted[0], fitted[1])
    if not with_frames:
        return judged, False, fitted[0], fitted[1]
    elsewhere = rms(own[0]) > ELSEWHERE * rms(fitted[0])
    if elsewhere:
        reason = (
            "the tracker or the targets stand elsewhere than in the fitted recording, whose frames would leave "
            f"{1e3 * rms(own[0]):.3g} mm per coordinate: all figures are with those that were fitted to this one"
        )
        judged, own = dataclasses.replace(judged, reason="; ".join(filter(None, (judged.reason, reason)))), fitted
    return judged, elsewhere, own[0], own[1]


def _with_set_up(problem: AbsoluteProblem, model: ModelParameters, shift: Float2D) -> Float2D:
    """Return what a model leaves of positions, (m, 3) m, base axes, once their tracker pose and targets were fitted.

    Args:
        problem: The positions.
        model: Its compliances and geometry stay.
        shift: (m, 3) m, base axes, how far its effects move the points.
    """
    seen = dataclasses.replace(problem, position=model.placed(problem.position, problem.recording), recording=None)
    freed, fitted = seen, start_parameters(seen, model.replace(setups=None))
    terms, _ = select_frames(seen, fitted)
    for _ in range(ROUNDS):  # the shift is known in base axes, which the tracker pose gives the positions
        freed = dataclasses.replace(seen, position=seen.position - fitted.tracker[:3, :3].T @ shift.T)
        fitted = fit(freed, fitted, terms).parameters
    return freed.residual(fitted).T


def _judged(kind: PartKind, part: Readings, cell: Cell, after: Float2D, before: Float2D) -> TestPart:
    judged = TestPart.of(kind, len(np.unique(part.configuration)), after, before)
    if rms(after - before) >= ALIKE * coordinate_std(position_covariance(part, cell)):
        return judged
    reason = "nothing that was found in the fitted recording changes their prediction, so that they say nothing of it"
    return dataclasses.replace(judged, reason=reason)
