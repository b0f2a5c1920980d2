"""`calibration plan`: measurement configurations and loads (Table 1 of the standard)."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections import Counter
from typing import Any

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.commands.arcs import arcs_told
from calibration_core.commands.clearance import clearance
from calibration_core.commands.common import digest_of, naming_model, report_line, scheduled_space, tell
from calibration_core.commands.plan_geometry import (
    GeometryPromise,
    geometry_result,
    geometry_section,
    geometry_summary,
    plan_geometry,
)
from calibration_core.commands.plan_protocols import judged_protocols, protocols_result, protocols_section
from calibration_core.diagnosis.protocol import PROTOCOLS, Worth
from calibration_core.errors import InputError, quoted
from calibration_core.identification.estimate import OperatingSpace
from calibration_core.model.model_file import read_model
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulate import Schedule
from calibration_core.procedure.loads import NINE_STEPS, LoadRules
from calibration_core.procedure.operating_space import iso_cube, read_task
from calibration_core.procedure.phases import PhaseRules, with_phases
from calibration_core.procedure.plan import Expected, Plan
from calibration_core.procedure.plan_file import plan_dict, plan_text
from calibration_core.procedure.planning import PlanningRules, ground_of, make_plan
from calibration_core.procedure.space import SpaceRules
from calibration_core.report.command_result import command_result, input_record
from calibration_core.report.output import RESULT, Content, write_files
from calibration_core.report.result import result_json
from calibration_core.report.rounding import counted, spread
from calibration_core.report.tables import TABLE_1, TABLE_1_YAML, table1_csv, table1_yaml
from calibration_core.timeseries import Float2D

PLAN = "plan.yaml"


def run(arguments: argparse.Namespace) -> str:
    """Make a plan, write it with Table 1 and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
    """
    tell(arguments, 0.0, "searching configurations")
    cell = load_cell(arguments.cell)
    parameters = nominal_parameters(cell) if arguments.model is None else read_model(arguments.model, cell)
    inputs = {} if arguments.model is None else {"model": digest_of(arguments.model)}
    rules, task = space_of(arguments, cell, parameters, rules_of(arguments))
    inputs |= {} if arguments.task is None else {"task": digest_of(arguments.task)}
    sized: dict[str, Any] = {
        "configurations": arguments.configurations,
        "spares": arguments.spares,
        "seed": arguments.seed,
    }
    geometry: GeometryPromise | None = None
    if arguments.purpose == "geometry":
        plan, geometry = plan_geometry(cell, parameters, rules, task=task, **sized)
    else:
        with naming_model(arguments.model):
            plan = make_plan(cell, rules=rules, parameters=parameters, task=task, **sized)
    if arguments.phases:
        tell(arguments, 0.4, "planning the phases before")
        phase_rules = PhaseRules(space=rules.space)
        plan, duration, unclear = with_phases(plan, cell, phase_rules, seed=arguments.seed, parameters=parameters)
        geometry = None if geometry is None else geometry.taking(duration, unclear)
    tell(arguments, 0.6, "judging load steps")
    protocols = judged_protocols(plan, cell, parameters)
    space = scheduled_space(Schedule.of(plan.primary), cell, parameters)
    content = plan_result(plan, cell, space, inputs, seed=arguments.seed, protocols=protocols)
    told: list[str] = [] if geometry is None else [geometry_summary(geometry)]
    result = result_json(content if geometry is None else {**content, "geometry": geometry_result(geometry)})
    files: dict[str, Content] = {RESULT: result, **plan_files(plan, cell)}
    if arguments.report:
        tell(arguments, 0.8, "drawing the report")
        from calibration_core.commands.plan_document import plan_document
        from calibration_core.report.rendering import rendered

        sections = protocols_section(protocols) if geometry is None else (geometry_section(geometry),)
        document = plan_document(plan, cell, space, result, inputs, seed=arguments.seed, further=sections)
        files |= rendered(document, space)
    write_files(arguments.out, files)
    where = f"plan: {arguments.out / PLAN} and {arguments.out / TABLE_1}"
    return "\n".join([plan_summary(plan), *arcs_told(plan, cell), *told, where, report_line(arguments)])


def rules_of(arguments: argparse.Namespace) -> PlanningRules:
    """Return the planning rules that the arguments ask for.

    Raises:
        InputError: Load levels, share or box make no sense.
    """
    named = {one.name.replace(" ", "-"): one.levels for one in PROTOCOLS if not one.hold}
    if arguments.protocol is not None and arguments.load_levels is not None:
        raise InputError("--protocol", "", "--protocol and --load-levels", "one of them")
    if arguments.protocol is not None and arguments.protocol not in named:
        raise InputError("--protocol", "", quoted(arguments.protocol), f"one of {', '.join(named)}")
    asked = named.get(arguments.protocol or "", arguments.load_levels)
    levels = NINE_STEPS if asked is None else tuple(asked)
    inside = all(math.isfinite(level) and -1.0 <= level <= 1.0 for level in levels)
    if not inside or levels[0] != 0.0 or max(levels) != 1.0 or len(levels) > 100:
        expected = (
            "shares from -1 (pulled the other way) to 1 of the full pull, the first 0 and the largest 1, "
            "for example 0 0.5 1 0.5 0"
        )
        raise InputError("--load-levels", "", quoted(list(levels)), expected)
    if not 0.0 < arguments.load_share <= 1.0:
        raise InputError(
            "--load-share", "", f"{arguments.load_share:g}", "a share of the rated load above 0, at most 1"
        )
    for name in ("largest_force", "largest_torque"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"--{name.replace('_', '-')}", "", f"{value:g}", "a positive number")
    load = LoadRules(
        levels=levels,
        share=arguments.load_share,
        largest_force=arguments.largest_force,
        largest_torque=arguments.largest_torque,
    )
    return PlanningRules(space=SpaceRules(box=_box(arguments.box)), load=load, criterion=arguments.criterion)


def space_of(
    arguments: argparse.Namespace, cell: Cell, parameters: ModelParameters, rules: PlanningRules
) -> tuple[PlanningRules, Float2D | None]:
    """Return the rules with the operating space that the arguments ask for, and the places of a task.

    Raises:
        InputError: More than one operating space is asked for, or it cannot be used.
    """
    asked = [f"--{name}" for name in ("box", "cube", "task") if getattr(arguments, name) is not None]
    if len(asked) > 1:
        raise InputError(asked[1], "", f"{' and '.join(asked)}", "one operating space")
    if arguments.cube is None and arguments.task is None:
        return rules, None
    ground = ground_of(cell, parameters, rules.space, None)
    if arguments.task is not None:
        return rules, read_task(arguments.task, ground)
    if not (arguments.cube == 0.0 or 0.05 <= arguments.cube <= 5.0):
        raise InputError("--cube", "", f"{arguments.cube:g}", "the side of a cube from 0.05 to 5 m, or nothing")
    box = iso_cube(ground, arguments.cube or None, arguments.seed)
    return dataclasses.replace(rules, space=dataclasses.replace(rules.space, box=box)), None


def _box(ends: list[float] | None) -> tuple[tuple[float, float], ...] | None:
    if ends is None:
        return None
    box = tuple(zip(ends[::2], ends[1::2], strict=True))
    if not all(math.isfinite(low) and math.isfinite(high) and low < high for low, high in box):
        raise InputError("--box", "", quoted(ends), "XMIN XMAX YMIN YMAX ZMIN ZMAX in m, each lower < upper")
    return box


def plan_files(plan: Plan, cell: Cell) -> dict[str, Content]:
    """Return `plan.yaml`, `table1.csv` and `table1.yaml`: file name -> content."""
    return {
        PLAN: plan_text(plan).encode(),
        TABLE_1: table1_csv(*plan.table1(), cell.prismatic),
        TABLE_1_YAML: table1_yaml(*plan.table1(), cell.prismatic),
    }


def plan_result(
    plan: Plan,
    cell: Cell,
    space: OperatingSpace,
    inputs: dict[str, dict[str, str]],
    *,
    seed: int,
    protocols: tuple[Worth, ...] = (),
) -> dict[str, Any]:
    """Return the content of result.json.

    Args:
        plan: What was planned.
        cell: The cell.
        space: Its operating space.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
        seed: Seed of the search.
        protocols: What other load steps would reveal.
    """
    steps = sum(len(configuration.steps) for configuration in plan.primary)
    content = plan_dict(plan)
    return command_result(
        "plan",
        cell,
        {
            "file": PLAN,
            "configurations": len(plan.primary),
            "steps": steps,
            "points": list(cell.points),
            "loaded": space.force is not None,
        },
        spares=len(plan.spares),
        expected=content["expected"],
        joints=content["joints"],
        preparation=dict(Counter(c.phase for c in plan.preparation)),
        largest_force=plan.largest_force,
        reference=content["reference"],
        startup_cycle=content["startup_cycle"],
        singularity=float(np.min(space.singularity)),
        seed=seed,
        protocols=protocols_result(protocols),
        input=input_record(cell, None, inputs),
    )


def certificate(expected: Expected) -> str:
    """Return what is certain of the choice, in words."""
    if expected.efficiency is None:
        return f"chosen by criterion {expected.criterion}, for which nothing certifies an optimum"
    share = 100 * expected.efficiency
    return f"criterion {expected.criterion}: certainly at least {share:.1f} % of what any choice could reach"


def plan_summary(plan: Plan) -> str:
    """Return what came out, in a few lines."""
    lines = [
        (
            f"{counted(len(plan.primary), 'configuration')} and {counted(len(plan.spares), 'spare')}, "
            f"{counted(len(plan.primary[0].steps), 'load step')}, largest force {plan.largest_force:,.0f} N"
        )
    ]
    if plan.preparation:
        phases = Counter(c.phase.replace("_", " ") for c in plan.preparation)
        told = ", ".join(f"{phase} {count}" for phase, count in phases.items())
        lines.append(f"standstills of the phases before: {told}")
    expected = plan.expected
    if expected is None:
        return "\n".join(lines)
    lines.append(f"{certificate(expected)}; condition number {expected.condition:.2f}")
    if expected.stiffness_std is not None:
        shares = (
            f"{joint} {spread(100 * std) + ' %' if math.isfinite(std) else 'not at all'}"
            for joint, std in zip(plan.joints, expected.stiffness_std, strict=True)
        )
        lines.append(f"expected standard deviation of the stiffness: {', '.join(shares)}")
    if expected.unidentifiable:
        lines.append(f"not identifiable from here: {', '.join(plan.joints[i] for i in expected.unidentifiable)}")
    if expected.duration:
        lines.append(f"takes about {expected.duration['total'] / 60:.0f} minutes without spares")
    lines.append(clearance(expected.unclear_moves, expected.unjudged))
    return "\n".join(lines)
