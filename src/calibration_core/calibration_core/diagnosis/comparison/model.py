"""Does the core's model, with the values of the cell file, say what a simulation says?"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.points import rigid
from calibration_core.diagnosis.comparison.result import Reproduction
from calibration_core.diagnosis.comparison.steps import UNLOADED
from calibration_core.errors import EquilibriumError
from calibration_core.identification.statistics import normal_equations, without_offsets
from calibration_core.identification.stiffness.fit import fit_compliance
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.identification.stiffness.problem import LoadedProblem, build_problem
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.observations.kinds import is_loaded
from calibration_core.policy import FEWEST_READINGS
from calibration_core.timeseries import Float1D, Readings

NOISE = 1.1  # times the claimed noise, that a model may leave and still be called the same
OTHER = 0.02  # relative change of a stiffness that is worth a word
FEWEST = 2  # configurations with several steps


@dataclasses.dataclass(frozen=True, eq=False)
class Misfit:
    """How far readings are from what the cell file's model predicts for them.

    Attributes:
        absolute: m per coordinate, positions; NaN for displacements.
        deflection: Share of the deflections that the model leaves; NaN without loaded steps or stiffnesses.
    """

    absolute: float
    deflection: float


def misfit(readings: Readings, cell: Cell) -> Misfit:
    """Compare readings with the cell file's model, nothing fitted but one offset per configuration and point."""
    model = nominal_parameters(cell)
    share = float("nan")
    unloaded = readings if readings.wrench is None else dataclasses.replace(readings, wrench=0 * readings.wrench)
    absolute = _absolute(unloaded, cell, model)
    if _bends(readings, model):
        try:
            share = _share(build_problem(readings, cell, chain_of(cell), model), model.compliance)
        except EquilibriumError:  # such loads bend no robot: nothing is farther off
            share = float("inf")
    return Misfit(absolute, share)


def _share(problem: LoadedProblem, compliance: Float1D) -> float:
    """Return what the model leaves of the deflections, as a share of them."""
    linear, rigid = problem.linearise(compliance), problem.linearise(np.zeros_like(compliance))
    left, seen = (without_offsets(part.rows, part.residual) for part in (linear, rigid))
    return float(np.sqrt(np.mean(left**2) / max(float(np.mean(seen**2)), 1e-30)))


def reproduction(readings: Readings, cell: Cell, seen: float | None = None) -> Reproduction:
    """Say whether the cell file's model reproduces a simulation to its noise.

    Args:
        readings: The simulation.
        cell: The cell file.
        seen: m per coordinate, noise that is seen in the simulation where that is more than claimed; None: as claimed.
    """
    model = nominal_parameters(cell)
    try:
        return _reproduction(readings, cell, model, seen)
    except EquilibriumError as error:
        text = f"The core's model cannot reproduce the simulation: under its loads there is {error}."
        nan = float("nan")
        return Reproduction(False, nan, nan, nan, {}, text)


def rigid_misfit(readings: Readings, cell: Cell) -> float:
    """Return what the cell file's model leaves of the positions after the best rigid frame, m per coordinate.

    Of readings at which next to nothing pulls, where there are enough.
    """
    if readings.wrench is not None:
        force = np.linalg.norm(readings.wrench[:, :3], axis=1)
        light = force <= UNLOADED * force.max()
        light |= light.sum() < FEWEST_READINGS
        readings = dataclasses.replace(readings.select(light), wrench=None)
    return rigid(readings.position, predict_readings(readings, cell, nominal_parameters(cell)))[2]


def _reproduction(readings: Readings, cell: Cell, model: ModelParameters, seen: float | None) -> Reproduction:
    noise = coordinate_std(position_covariance(readings, cell))
    absolute = _absolute(readings, cell, model)
    most, to_noise = (NOISE, "the claimed noise") if seen is None else (NOISE * seen / noise, "the noise seen in it")
    near = not absolute > most * noise  # NaN: no absolute positions to compare
    if not _bends(readings, model):
        words = "The core's model, with the cell file's values, "
        words += "reproduces the simulation's positions." if near else _far(absolute, noise)
        return Reproduction(near, float("nan"), float("nan"), absolute, {}, words)
    problem = build_problem(readings, cell, chain_of(cell), model)
    ratio = _ratio(problem, model.compliance)
    if ratio <= most:
        text = f"The core's model reproduces the simulation's deflections to {to_noise} with the cell file's values"
        text += "." if near else f", and in the positions {_far(absolute, noise)}"
        return Reproduction(near, ratio, float("nan"), absolute, {}, text)
    fit = fit_compliance(problem, model.compliance)
    again = _ratio(problem, fit.compliance)
    changes = {
        joint: float(before / after - 1)
        for joint, before, after in zip(model.joints, model.compliance, fit.compliance, strict=True)
        if after > 0 and abs(before / after - 1) > OTHER
    }
    text = (
        f"The core's model does not reproduce the simulation with the cell file's values: its deflections are left "
        f"with {ratio:.1f} times the claimed noise"
    )
    if again <= most:
        listed = ", ".join(f"{joint} {100 * change:+z.0f} %" for joint, change in changes.items())
        text += f"; with other stiffnesses it does ({listed or 'all within 2 %'} against the cell file)."
    else:
        text += f", with refitted stiffnesses {again:.1f} times: the simulation holds physics that the model does not."
    return Reproduction(False, ratio, again, absolute, changes, text, fit.compliance if again <= most else None)


def _bends(readings: Readings, model: ModelParameters) -> bool:
    """Say whether there are deflections to compare, and stiffnesses to predict them with."""
    if not is_loaded(readings) or readings.wrench is None or not np.any(model.compliance):
        return False
    if not np.any(np.ptp(readings.wrench, axis=0) > 0):
        return False
    pairs = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    _, counts = np.unique(pairs[:, 0], return_counts=True)
    return int((counts > 1).sum()) >= FEWEST


def _absolute(readings: Readings, cell: Cell, model: ModelParameters) -> float:
    if cell.measurements.points == "displacement" or cell.frames.tracker is None:
        return float("nan")
    return float(np.sqrt(np.mean((readings.position - predict_readings(readings, cell, model)) ** 2)))


def _ratio(problem: LoadedProblem, compliance: Float1D) -> float:
    """Return what the model leaves in units of the claimed noise."""
    linear = problem.linearise(compliance)
    normal = normal_equations(linear.rows, linear.residual, linear.columns[:, :, :0])
    return float(np.sqrt(normal.chi2.sum() / max(int(normal.freedom.sum()), 1)))


def _far(absolute: float, noise: float) -> str:
    return (
        f"is {1e3 * absolute:.3f} mm (rms per coordinate) from it, {absolute / noise:.0f} times the claimed noise: "
        "frames, points or geometry of the two are not the same."
    )
