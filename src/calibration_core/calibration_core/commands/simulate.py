"""`calibration simulate`: a recording as the cell's model predicts it."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.common import digest_of, naming_model, report_line, scheduled_space, tell
from calibration_core.commands.plan import PLAN, plan_files
from calibration_core.errors import OutputError
from calibration_core.identification.estimate import OperatingSpace
from calibration_core.model.model_file import read_model
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulate import Schedule, simulate_plan
from calibration_core.model.streams import as_recording
from calibration_core.procedure.plan import Plan
from calibration_core.procedure.plan_file import read_plan
from calibration_core.procedure.planning import make_plan
from calibration_core.recording.bag_writer import write_bag
from calibration_core.recording.table import write_table
from calibration_core.report.command_result import command_result, input_record
from calibration_core.report.output import RESULT, Content, write_files
from calibration_core.report.result import result_json
from calibration_core.report.rounding import counted, spread
from calibration_core.timeseries import Readings, Recording

BAG, TABLE = "recording", "measurements.csv"


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """What was simulated, and by which model.

    Attributes:
        plan: What was measured, spares left out.
        made: Whether the plan was made here, because none was given.
        parameters: The model that answered.
        seed: Seed of the instrument noise; None: no noise.
        readings: The measurement table.
        recording: The streams of the bag.
        space: The operating space, with the deflections under the largest load.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
    """

    plan: Plan
    made: bool
    parameters: ModelParameters
    seed: int | None
    readings: Readings
    recording: Recording
    space: OperatingSpace
    inputs: dict[str, dict[str, str]]

    @property
    def loaded(self) -> bool:
        """Whether the plan has external loads."""
        return self.space.force is not None

    @property
    def deflections(self) -> np.ndarray:
        """(k,) m, length of the first point's deflection under each configuration's largest force; zeros unloaded."""
        deflection = self.space.deflection
        return np.zeros(len(self.space.q)) if deflection is None else np.linalg.norm(deflection, axis=1)


def run(arguments: argparse.Namespace) -> str:
    """Simulate a plan, write bag, table and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    tell(arguments, 0.0, "simulating the measurement")
    cell = load_cell(arguments.cell)
    simulated = simulate(cell, arguments.plan, arguments.model, arguments.seed)
    _require_own(arguments.out)
    result = result_json(simulation_result(simulated, cell))
    bag_cell = _for_streams(cell)
    files: dict[str, Content] = {
        RESULT: result,
        BAG: lambda path: write_bag(path, simulated.recording, bag_cell),
        TABLE: lambda path: write_table(path, simulated.readings),
        **(plan_files(simulated.plan, cell) if simulated.made else {}),
    }
    if arguments.report:
        tell(arguments, 0.5, "drawing the report")
        from calibration_core.commands.simulate_document import simulation_document
        from calibration_core.report.rendering import rendered

        files |= rendered(simulation_document(simulated, cell, result), simulated.space)
    write_files(arguments.out, files)
    where = f"recording: {arguments.out / BAG} and {arguments.out / TABLE}"
    return f"{simulation_summary(simulated)}\n{where}\n{report_line(arguments)}"


def simulate(cell: Cell, plan: Path | None, model: Path | None, seed: int | None) -> Simulated:
    """Predict all readings and streams of a plan.

    Args:
        cell: The cell.
        plan: Plan file; None makes a plan.
        model: Identified model; None takes what the cell file believes.
        seed: Of the instrument noise; None: none.

    Raises:
        InputError: Plan, model or cell cannot be used.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    parameters = nominal_parameters(cell) if model is None else read_model(model, cell)
    with naming_model(model):
        chosen = make_plan(cell, parameters=parameters) if plan is None else read_plan(plan, cell)
    schedule = Schedule.of(chosen.primary)
    if np.any(schedule.wrench) and not np.any(parameters.compliance):
        raise cell.missing("robot.stiffness", "simulating deflections (or an identified model, --model)")
    files = {"plan": plan, "model": model}
    measured = (*chosen.preparation, *chosen.primary)
    with naming_model(model):
        readings = simulate_plan(measured, cell, parameters, seed)
    return Simulated(
        plan=chosen,
        made=plan is None,
        parameters=parameters,
        seed=seed,
        readings=readings,
        recording=as_recording(measured, _for_streams(cell), parameters, seed),
        space=scheduled_space(schedule, cell, parameters),
        inputs={role: digest_of(path) for role, path in files.items() if path is not None},
    )


def _for_streams(cell: Cell) -> Cell:
    """Return the cell with absolute points: a tracker streams positions, also where a table holds differences."""
    if cell.measurements.points == "absolute":
        return cell
    return cell.model_copy(update={"measurements": cell.measurements.model_copy(update={"points": "absolute"})})


def _require_own(directory: Path) -> None:
    """Refuse to replace a recording that is not known to be simulated.

    Raises:
        OutputError: A recording stands in the directory without a result of this command beside it.
    """
    there = [name for name in (BAG, TABLE) if (directory / name).exists()]
    if not there:
        return
    try:
        content = json.loads((directory / RESULT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        content = None
    if not isinstance(content, dict) or content.get("command") != "simulate":
        expected = "a directory without recordings, or one that this command has written"
        raise OutputError(directory, there[0], "a recording that was not simulated here", expected)


def simulation_result(simulated: Simulated, cell: Cell) -> dict[str, Any]:
    """Return the content of result.json."""
    readings, plan = simulated.readings, simulated.plan
    return command_result(
        "simulate",
        cell,
        {
            "file": BAG,
            "configurations": len(plan.primary),
            "steps": sum(len(configuration.steps) for configuration in plan.primary),
            "points": list(readings.points),
            "loaded": simulated.loaded,
            "readings": len(readings),
            "table": TABLE,
        },
        model={
            "joints": list(simulated.parameters.joints),
            "compliance": simulated.parameters.compliance,
            "identified": "model" in simulated.inputs,
            "effects": [
                {"effect": effect.effect, "location": dict(effect.location), "variant": effect.variant}
                for effect in simulated.parameters.effects
            ],
        },
        noise_seed=simulated.seed,
        plan=PLAN if simulated.made else None,
        deflection={"largest": float(np.max(simulated.deflections)), "point": readings.points[0], "unit": "m"},
        messages=dict(simulated.recording.provenance.messages),
        input=input_record(cell, None, simulated.inputs),
    )


def simulation_summary(simulated: Simulated) -> str:
    """Return what came out, in a few lines."""
    steps = sum(len(configuration.steps) for configuration in simulated.plan.primary)
    noise = "without noise" if simulated.seed is None else f"with instrument noise, seed {simulated.seed}"
    model = "identified model" if "model" in simulated.inputs else "the cell file's model"
    if simulated.parameters.effects:
        model += f" with {counted(len(simulated.parameters.effects), 'effect')}"
    largest = spread(1e3 * float(np.max(simulated.deflections)))
    return (
        f"{counted(len(simulated.plan.primary), 'configuration')}, {counted(steps, 'step')}, "
        f"{counted(len(simulated.readings), 'reading')} simulated by {model}, {noise}\n"
        f"largest deflection of {simulated.readings.points[0]}: {largest} mm"
    )
