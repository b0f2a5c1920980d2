"""A plan as a model measures it: readings and streams."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.model.identified.given import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import Schedule, simulate_plan
from calibration_core.model.simulation.streams import as_recording
from calibration_core.outcomes.inputs import naming_model, refuse_lengths
from calibration_core.outcomes.spaces import scheduled_space
from calibration_core.planning.loaded import make_plan
from calibration_core.planning.plans.plan import Plan
from calibration_core.timeseries import Note, Readings, Streams

BAG, TABLE = "recording", "measurements.csv"


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """What was simulated, and by which model.

    Attributes:
        plan: What was measured, spares left out.
        made: Whether the plan was made here, because none was given.
        parameters: The simulated model.
        seed: Seed of the instrument noise; None: no noise.
        readings: The measurement table.
        recording: The streams of the bag.
        space: The operating space, with the deflections under the largest load.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
        notes: What must be stated of the given model.
    """

    plan: Plan
    made: bool
    parameters: ModelParameters
    seed: int | None
    readings: Readings
    recording: Streams
    space: OperatingSpace
    inputs: dict[str, dict[str, str]]
    notes: tuple[Note, ...] = ()

    @property
    def loaded(self) -> bool:
        """Whether the plan has external loads."""
        return self.space.force is not None

    @property
    def deflections(self) -> np.ndarray:
        """(k,) m, length of the first point's deflection under each configuration's largest force; zeros unloaded."""
        deflection = self.space.deflection
        return np.zeros(len(self.space.q)) if deflection is None else np.linalg.norm(deflection, axis=1)


def simulate(
    cell: Cell,
    plan: Plan | None,
    given: GivenModel | None,
    seed: int | None,
    inputs: Mapping[str, dict[str, str]] | None = None,
) -> Simulated:
    """Predict all readings and streams of a plan.

    Args:
        cell: The cell.
        plan: What is measured; None makes a plan.
        given: An identified model; None takes what the cell file believes.
        seed: Of the instrument noise; None: none.
        inputs: Role -> file -> SHA-256 of the files that the plan came from.

    Raises:
        InputError: Plan, model or cell cannot be used.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    refuse_lengths(cell)
    parameters = nominal_parameters(cell) if given is None else given.parameters
    named = None if given is None else Path(given.file)
    with naming_model(named):
        chosen = make_plan(cell, parameters=parameters) if plan is None else plan
    schedule = Schedule.of(chosen.primary)
    if np.any(schedule.wrench) and not np.any(parameters.compliance):
        raise cell.missing("robot.stiffness", "simulating deflections (or an identified model, --model)")
    measured = (*chosen.preparation, *chosen.primary)
    with naming_model(named):
        readings = simulate_plan(measured, cell, parameters, seed)
    return Simulated(
        plan=chosen,
        made=plan is None,
        parameters=parameters,
        seed=seed,
        readings=readings,
        recording=as_recording(measured, for_streams(cell), parameters, seed),
        space=scheduled_space(schedule, cell, parameters),
        inputs={**(inputs or {}), **({} if given is None else given.digest)},
        notes=() if given is None else given.notes,
    )


def for_streams(cell: Cell) -> Cell:
    """Return the cell with absolute points: a tracker streams positions, also where a table holds differences."""
    if cell.measurements.points == "absolute":
        return cell
    return cell.model_copy(update={"measurements": cell.measurements.model_copy(update={"points": "absolute"})})


def as_stated(readings: Readings, cell: Cell) -> Readings:
    """Return readings with the joint angles of the cell's files, where one joint's angle is coupled to another's."""
    if not cell.robot.joint_coupling:
        return readings
    return dataclasses.replace(readings, q=readings.q @ np.linalg.inv(cell.robot.coupling).T)
