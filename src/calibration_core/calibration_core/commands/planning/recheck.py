"""`calibration plan --for verify`: the smallest set of poses that decides whether a calibration still holds."""

from __future__ import annotations

import argparse
import dataclasses
import math
from typing import Any

import numpy as np

from calibration_core.acceptance.recheck import Recheck, recheck
from calibration_core.cell import Cell
from calibration_core.errors import InputError, PlanError, rounded_up
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.planning.feasible.candidates import Ground, draw_postures
from calibration_core.planning.feasible.loads import full_pulls
from calibration_core.planning.feasible.order import startup_cycle
from calibration_core.planning.loaded import ROUNDS, PlanningRules, ground_of, not_reached, reached
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration, Reference
from calibration_core.planning.plans.planned_robot import planned_robot
from calibration_core.planning.route import clear_order
from calibration_core.report.document import Column, Facts, Section, Table
from calibration_core.report.rounding import counted, fixed, listed, significant
from calibration_core.timeseries import Float1D, Float2D, Int1D

POSTURES = 300  # that stand for the operating space, and to choose from
LEAST_RISK, MOST_RISK = 1e-4, 0.4
LEVELS = (0.0, 1.0)  # unloaded, and the full pull


def require_asked(arguments: argparse.Namespace) -> float:
    """Return the tolerance, m.

    Raises:
        InputError: Model or tolerance are missing, or numbers make no sense.
    """
    if arguments.model is None:
        raise InputError("plan --for verify", "--model", "nothing", "the model whose calibration is in question")
    tolerance: float | None = arguments.tolerance
    if tolerance is None or not math.isfinite(tolerance) or tolerance <= 0:
        raise InputError("plan --for verify", "--tolerance", f"{tolerance}", "a length above zero, m")
    if not LEAST_RISK <= arguments.risk <= MOST_RISK:
        raise InputError("plan --for verify", "--risk", f"{arguments.risk:g}", f"{LEAST_RISK:g} to {MOST_RISK:g}")
    if arguments.phases:
        raise InputError("plan --for verify", "--phases", "both", "one of --for verify and --phases")
    return tolerance


def plan_recheck(
    cell: Cell,
    model: CalibratedModel,
    rules: PlanningRules,
    tolerance: float,
    risk: float,
    *,
    seed: int,
    task: Float2D | None = None,
) -> tuple[Plan, Recheck]:
    """Make a plan of 5 to 8 poses, each unloaded and, where the cell can load the robot, under the full pull.

    Raises:
        CellError: The robot cannot be read.
        PlanError: Too few postures can be reached and seen, or no poses decide at this tolerance.
    """
    if cell.measurements.points == "displacement":
        raise PlanError(cell.path, "measurements.points", "displacement", "absolute positions, to see the geometry")
    parameters = model.parameters
    ground = ground_of(cell, parameters, rules.space, task)
    rng = np.random.default_rng([seed, 5])
    q = draw_postures(ground, POSTURES, rules.batches, 2 * POSTURES // 10, rng)
    steps = _steps(cell, model, rules, len(q), rng)
    chosen, found, reference = _chosen(ground, model, q, steps, rules, (tolerance, risk, seed))
    if found.least_tolerance > tolerance:
        least = f"at least {rounded_up(found.least_tolerance):g} m"
        expected = f"{least}: below, the instruments leave an unchanged robot undecided"
        raise PlanError("plan --for verify", "--tolerance", f"{tolerance:g} m", expected)
    speed = np.full(ground.site.chain.n, rules.joint_speed)
    way, _ = clear_order(ground.bodies, q[chosen], reference, rules.reference_every, speed)
    plan = Plan(
        robot=cell.robot.name,
        joints=cell.robot.joints,
        configurations=tuple(PlannedConfiguration(i + 1, q[row], steps[row]) for i, row in enumerate(chosen[way])),
        startup_cycle=startup_cycle(ground.bodies, reference, seed=seed),
        reference=Reference(reference, rules.reference_every) if rules.reference_every else None,
        made_for=planned_robot(cell),
    )
    return plan, found


def can_load(cell: Cell, parameters: ModelParameters) -> bool:
    """Say whether a re-check loads the robot: there is a point to pull at, a sensor, and a joint that yields."""
    measured = parameters.wrench_point is not None and cell.instruments.force_torque is not None
    return measured and bool(np.any(parameters.compliance > 0))


def _steps(cell: Cell, model: CalibratedModel, rules: PlanningRules, count: int, rng: np.random.Generator) -> Any:
    """Return the wrenches of every posture's steps, (count, k, 6)."""
    parameters = model.parameters
    if not can_load(cell, parameters):
        return np.zeros((count, 1, 6))
    pull = full_pulls(cell, parameters, dataclasses.replace(rules.load, directions=1), count, rng)[:, 0]
    steps = np.zeros((count, len(LEVELS), 6))
    steps[:, :, :3] = np.array(LEVELS)[None, :, None] * pull[:, None, :]
    return steps


def _chosen(
    ground: Ground,
    model: CalibratedModel,
    q: Float2D,
    steps: Any,
    rules: PlanningRules,
    asked: tuple[float, float, int],
) -> tuple[Int1D, Recheck, Float1D]:
    """Return rows of poses that can be reached from a reference, what they decide, and the reference."""
    offered = np.arange(len(q))
    none = np.zeros(0, dtype=np.int64)
    tolerance, risk, seed = asked
    chosen = none
    for _ in range(ROUNDS):
        configurations = [PlannedConfiguration(int(row) + 1, q[row], steps[row]) for row in offered]
        readings = simulate_plan(configurations, ground.cell, model.parameters)
        found = recheck(readings, ground.cell, model, tolerance, risk, seed)
        chosen = found.chosen - 1
        reference, apart = reached(ground, q, chosen, none, rules)
        if not apart:
            return chosen, found, reference
        offered = np.setdiff1d(offered, apart)
    raise not_reached(ground, len(chosen))


def recheck_result(found: Recheck) -> dict[str, Any]:
    """Return what the poses decide as a part of result.json."""
    return {
        "tolerance": found.tolerance,
        "risk": found.risk,
        "decides": not found.missed,
        "coverage": found.coverage,
        "coverage_needed": found.needed,
        "missed": list(found.missed),
        "least_tolerance": found.least_tolerance,
        "standard_uncertainty": found.uncertainty,
        "unit": "m",
    }


def recheck_question(found: Recheck) -> str:
    """Return what the poses are for."""
    poses = counted(len(found.chosen), "pose")
    return f"{poses} for the question: does the calibration hold within {1e3 * found.tolerance:g} mm?"


def recheck_summary(found: Recheck) -> list[str]:
    """Return what the poses decide, in a few lines."""
    sure = f"{100 * (1 - found.risk):g} %"
    tolerance = f"{1e3 * found.tolerance:g} mm"
    lines = [recheck_question(found)]
    if found.missed:
        worst = found.missed[0]
        reach = found.tolerance / max(found.coverage[worst], 1e-9)
        lines.append(
            f"not decided by 8 poses: {listed(found.missed)}; a change of {worst} is seen from {_least(reach)} on"
        )
    else:
        lines.append(f"any single change that reaches {tolerance} in 5 % of the operating space is seen with {sure}")
    lines.append(
        f"an unchanged robot conforms with {sure}; smallest tolerance with these instruments "
        f"{_least(found.least_tolerance)}"
    )
    return lines


def _least(length: float) -> str:
    """Return a smallest length (m) in mm, rounded so that what is stated is enough."""
    return f"{significant(1e3 * rounded_up(length), 3)} mm"


def recheck_section(found: Recheck) -> Section:
    """Return the section of the report."""
    facts = Facts(
        (
            ("Tolerance", f"{1e3 * found.tolerance:g} mm"),
            ("Risk of either wrong answer", f"{100 * found.risk:g} %"),
            ("Standard uncertainty", f"{1e6 * found.uncertainty:.1f} µm, the least certain reading"),
            ("Smallest tolerance", f"{_least(found.least_tolerance)} with these poses and instruments"),
        )
    )
    rows = tuple(
        (name, fixed(share, 2), "no" if name in found.missed else "yes") for name, share in found.coverage.items()
    )
    columns = (
        Column("Change", "left", wide=True),
        Column("Largest error at the poses / its size"),
        Column("Decided", "left"),
    )
    note = (
        "The size of a change is the error that it stays below in 95 % of the operating space, the tracker's pose "
        f"fitted anew; decided from {found.needed:.2f} on."
    )
    return Section("Decision on the calibration", "", (facts, Table("Single changes", columns, rows, note)))
