"""`calibration simulate`: a recording as the cell's model predicts it."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.planning.plan import PLAN, plan_files
from calibration_core.commands.shared.common import report_line, report_progress, typed
from calibration_core.model.identified.model_file import read_given
from calibration_core.outcomes.inputs import digest_of, refuse_lengths
from calibration_core.outcomes.simulation import BAG, TABLE, Simulated, as_stated, for_streams, simulate
from calibration_core.planning.plans.plan_file import read_plan
from calibration_core.recording.bags.writer import write_bag
from calibration_core.recording.tables.table import write_table
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.result import result_json
from calibration_core.report.rounding import counted, spread
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.timeseries import TimeSeries


def run(arguments: argparse.Namespace) -> str:
    """Simulate a plan, write bag, table and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    report_progress(arguments, 0.0, "simulating the measurement")
    cell = load_cell(arguments.cell)
    refuse_lengths(cell)
    given = None if arguments.model is None else read_given(arguments.model, cell)
    plan = None if arguments.plan is None else read_plan(arguments.plan, cell)
    inputs = {} if arguments.plan is None else {"plan": digest_of(arguments.plan)}
    simulated = simulate(cell, plan, given, arguments.seed, inputs)
    report_progress(arguments, 0.5, "drawing the report" if arguments.report else "writing the results")
    following = f"next: {typed('identify', arguments.out / BAG, '--cell', arguments.cell)}"
    write_files(arguments.out, files_of(simulated, cell, report=arguments.report, following=following))
    where = f"recording: {arguments.out / BAG} and {arguments.out / TABLE}"
    return f"{simulation_summary(simulated)}\n{where}\n{report_line(arguments)}\n{following}"


def files_of(simulated: Simulated, cell: Cell, *, report: bool, following: str = "") -> dict[str, Content]:
    """Return all files of a simulation, name -> content; the summary in result.json ends with what `following` says."""
    content = simulation_result(simulated, cell)
    result = result_json({**content, "summary": [*content["summary"], *([following] if following else [])]})
    bag_cell, recording = for_streams(cell), simulated.recording
    if cell.robot.joint_coupling:
        back, joints = np.linalg.inv(cell.robot.coupling).T, recording.joints
        stated = TimeSeries(joints.time, joints.values @ back, joints.received, joints.frame)
        recording = dataclasses.replace(recording, joints=stated)
    files: dict[str, Content] = {
        RESULT: result,
        BAG: lambda path: write_bag(path, recording, bag_cell),
        TABLE: lambda path: write_table(path, as_stated(simulated.readings, cell)),
        **(plan_files(simulated.plan, cell) if simulated.made else {}),
    }
    if not report:
        return files
    from calibration_core.report.documents.simulation import simulation_document
    from calibration_core.report.view3d.space import space_view
    from calibration_core.report.writing.rendering import rendered

    return {**files, **rendered(simulation_document(simulated, cell, result), space_view(simulated.space, cell))}


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
        notes=[vars(note) for note in simulated.notes],
        input=input_record(cell, None, simulated.inputs),
        summary=simulation_summary(simulated).splitlines(),
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
        + "".join(f"\n{note.line}" for note in simulated.notes)
    )
