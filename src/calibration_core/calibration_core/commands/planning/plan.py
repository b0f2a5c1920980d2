"""`calibration plan`: measurement configurations and loads (Table 1 of the standard)."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.acceptance.recheck import Recheck
from calibration_core.cell import Cell, load_cell
from calibration_core.commands.planning.arguments import refuse_idle, refuse_idle_loads
from calibration_core.commands.planning.geometry import (
    GeometryExpectation,
    geometry_result,
    geometry_section,
    geometry_summary,
    plan_geometry,
)
from calibration_core.commands.planning.population import (
    Sisters,
    sisters_of,
    sisters_result,
    sisters_section,
    sisters_summary,
)
from calibration_core.commands.planning.protocols import judged_protocols, protocols_result, protocols_section
from calibration_core.commands.planning.recheck import (
    can_load,
    plan_recheck,
    recheck_question,
    recheck_result,
    recheck_section,
    recheck_summary,
    require_asked,
)
from calibration_core.commands.shared.common import report_line, report_progress, typed
from calibration_core.commands.shared.population_arguments import asked_population
from calibration_core.diagnosis.proposals.protocol import PROTOCOLS, Worth
from calibration_core.errors import InputError, quoted
from calibration_core.fleet.next_robot.planning import FEWEST
from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.model.identified.model_file import GivenModel, read_calibrated, read_given
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import Schedule
from calibration_core.model.urdf import lost_meshes, urdf_shapes
from calibration_core.outcomes.inputs import digest_of, naming_model, refuse_lengths
from calibration_core.outcomes.spaces import scheduled_space
from calibration_core.planning.feasible.loads import NINE_STEPS, LoadRules
from calibration_core.planning.feasible.operating_space import iso_cube, read_task
from calibration_core.planning.feasible.space import SpaceRules
from calibration_core.planning.loaded import LEAST_CONFIGURATIONS, PlanningRules, ground_of, make_plan
from calibration_core.planning.phases import PhaseRules, with_phases
from calibration_core.planning.plans.plan import Expected, Plan
from calibration_core.planning.plans.plan_file import plan_dict, plan_text
from calibration_core.report.documents.arcs import describe_arcs
from calibration_core.report.documents.clearance import clearance
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.result import result_json
from calibration_core.report.rounding import counted, spread
from calibration_core.report.writing.output import RESULT, Content, write_files
from calibration_core.report.writing.tables import TABLE_1, TABLE_1_YAML, table1_csv, table1_yaml
from calibration_core.timeseries import Float2D, Note

PLAN = "plan.yaml"


@dataclasses.dataclass(frozen=True, eq=False)
class Planned:
    """A plan with what is said of it.

    Attributes:
        plan: Configurations, loads and order.
        seed: Seed of the search.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
        protocols: What other load steps would reveal.
        geometry: What is promised of frames and geometry; None for a plan for stiffness.
        again: What is promised of a re-check; None for a plan to calibrate by.
        sisters: What robots of the same type are worth; None where none are known.
        notes: What must be stated of the given model, and of meshes that are missing.
    """

    plan: Plan
    cell: Cell
    space: OperatingSpace
    seed: int
    inputs: dict[str, dict[str, str]]
    protocols: tuple[Worth, ...]
    geometry: GeometryExpectation | None
    again: Recheck | None = None
    sisters: Sisters | None = None
    notes: tuple[Note, ...] = ()
    following: str = ""

    @functools.cached_property
    def content(self) -> dict[str, Any]:
        """The content of result.json."""
        content = plan_result(self.plan, self.cell, self.space, self.inputs, seed=self.seed, protocols=self.protocols)
        content["notes"] = [vars(note) for note in self.notes]
        content["summary"] = self.summary.splitlines()
        if self.sisters is not None:
            content = {**content, "population": sisters_result(self.sisters)}
        if self.again is not None:
            return {**content, "verify": recheck_result(self.again)}
        return content if self.geometry is None else {**content, "geometry": geometry_result(self.geometry)}

    @property
    def summary(self) -> str:
        """What came out, in a few lines."""
        expected = [] if self.geometry is None else [geometry_summary(self.geometry)]
        expected = expected if self.again is None else recheck_summary(self.again)
        expected += [] if self.sisters is None else sisters_summary(self.sisters)
        expected += [note.line for note in self.notes]
        expected += [f"next: measure it, then {self.following}"] if self.following else []
        return "\n".join([plan_summary(self.plan), *describe_arcs(self.plan, self.cell), *expected])

    def files(self, *, report: bool) -> dict[str, Content]:
        """Return all files of the plan: file name -> content."""
        result = result_json(self.content)
        files: dict[str, Content] = {RESULT: result, **plan_files(self.plan, self.cell)}
        if not report:
            return files
        from calibration_core.report.documents.plan import plan_document
        from calibration_core.report.view3d.space import space_view
        from calibration_core.report.writing.rendering import rendered

        geometry, protocols = self.geometry, self.protocols
        sections = protocols_section(protocols) if geometry is None else (geometry_section(geometry),)
        sections = sections if self.again is None else (recheck_section(self.again),)
        sections = sections if self.sisters is None else (sisters_section(self.sisters), *sections)
        document = plan_document(
            self.plan,
            self.cell,
            self.space,
            result,
            self.inputs,
            seed=self.seed,
            further=sections,
            purpose="" if self.again is None else recheck_question(self.again),
            notes=self.notes,
        )
        return {**files, **rendered(document, space_view(self.space, self.cell))}


def run(arguments: argparse.Namespace) -> str:
    """Make a plan, write it with Table 1 and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
    """
    report_progress(arguments, 0.0, "searching configurations")
    cell = load_cell(arguments.cell)
    planned = make(arguments, cell, None if arguments.model is None else read_given(arguments.model, cell))
    report_progress(arguments, 0.8, "drawing the report" if arguments.report else "writing the results")
    write_files(arguments.out, planned.files(report=arguments.report))
    *lines, following = planned.summary.splitlines()
    where = f"plan: {arguments.out / PLAN} and {arguments.out / TABLE_1}"
    return "\n".join([*lines, where, report_line(arguments), following])


def next_step(arguments: argparse.Namespace) -> str:
    """Return the command that evaluates what the plan is for, once it is measured."""
    words: list[str | Path] = ["RECORDING", "--cell", arguments.cell]
    if arguments.purpose == "verify":
        judged = ("--model", arguments.model, "--tolerance", f"{arguments.tolerance:g}", "--fit-tracker")
        return typed("verify", *words, *judged)
    if arguments.population is None:
        return typed("identify", *words)
    of_type = () if arguments.type is None else ("--type", arguments.type)
    return typed("diagnose", *words, "--population", arguments.population, *of_type)


def make(arguments: argparse.Namespace, cell: Cell, given: GivenModel | None) -> Planned:
    """Make the plan that the options of the command ask for.

    Args:
        arguments: The options.
        cell: The cell.
        given: The model to plan with; None: the cell file's.

    Raises:
        InputError: The options make no sense, or no plan can be made under them.
    """
    refuse_idle(arguments)
    refuse_lengths(cell)
    population = asked_population(arguments, cell)
    if population is not None and arguments.purpose != "stiffness":
        raise InputError("--population", "", f"--for {arguments.purpose}", "a plan for stiffness")
    parameters = nominal_parameters(cell) if given is None else given.parameters
    inputs = {} if given is None else given.digest
    loads = arguments.purpose != "verify" or can_load(cell, parameters)
    refuse_idle_loads(arguments, loads=loads, torque=parameters.force_torque is not None)
    rules, task = space_of(arguments, cell, parameters, rules_of(arguments))
    inputs |= {} if population is None else {"population": {population.file: population.sha256}}
    inputs |= {} if arguments.task is None else {"task": digest_of(arguments.task)}
    sized: dict[str, Any] = {
        "configurations": arguments.configurations,
        "spares": arguments.spares,
        "seed": arguments.seed,
    }
    geometry: GeometryExpectation | None = None
    again: Recheck | None = None
    if arguments.purpose == "verify":
        tolerance = require_asked(arguments)
        model = read_calibrated(arguments.model, cell)
        with naming_model(arguments.model):
            plan, again = plan_recheck(cell, model, rules, tolerance, arguments.risk, seed=arguments.seed, task=task)
    elif arguments.purpose == "geometry":
        plan, geometry = plan_geometry(cell, parameters, rules, task=task, **sized)
    else:
        with naming_model(None if given is None else Path(given.file)):
            least = LEAST_CONFIGURATIONS if population is None else FEWEST
            plan = make_plan(cell, rules=rules, parameters=parameters, task=task, least=least, **sized)
    if arguments.phases:
        report_progress(arguments, 0.4, "planning the phases before")
        phase_rules = PhaseRules(space=rules.space)
        plan, duration, unclear = with_phases(plan, cell, phase_rules, seed=arguments.seed, parameters=parameters)
        geometry = None if geometry is None else geometry.taking(duration, unclear)
    report_progress(arguments, 0.6, "judging load steps")
    protocols = judged_protocols(plan, cell, parameters)
    space = scheduled_space(Schedule.of(plan.primary), cell, parameters)
    sisters = None if population is None else sisters_of(plan, population, arguments.accuracy)
    notes = () if given is None else given.notes
    if cell.robot.joint_coupling:
        text = (
            "Table 1 states the angles of the robot file; on the robot's own display the coupled joints stand elsewhere"
        )
        notes = (*notes, Note("joint_coupling", "robot.joint_coupling", text))
    if arguments.purpose == "stiffness" and rules.load.levels[-1] != 0.0:
        text = "no step returns to zero load: drift of tracker or robot within a configuration will not be seen"
        notes = (*notes, Note("no_return_to_zero", "--load-levels", text))
    missing = lost_meshes(urdf_shapes(cell)[1])
    notes = (*notes, Note("missing_mesh", "robot.urdf", missing)) if missing else notes
    following = next_step(arguments)
    return Planned(plan, cell, space, arguments.seed, inputs, protocols, geometry, again, sisters, notes, following)


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
    if not inside or not levels or levels[0] != 0.0 or max(levels) != 1.0 or len(levels) > 100:
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
    box = tuple(zip(ends[::2], ends[1::2], strict=False))
    if len(ends) != 6 or not all(math.isfinite(low) and math.isfinite(high) and low < high for low, high in box):
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
        return f"chosen by criterion {expected.criterion}, for which no bound certifies an optimum"
    share = 100 * expected.efficiency
    return f"criterion {expected.criterion}: at least {share:.1f} % of what any choice could reach"


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
        counts = ", ".join(f"{phase} {count}" for phase, count in phases.items())
        lines.append(f"postures of the phases before: {counts}")
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
