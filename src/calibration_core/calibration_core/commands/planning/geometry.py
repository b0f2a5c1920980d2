"""`calibration plan --for geometry`: postures for frames and geometry, and what they promise."""

from __future__ import annotations

import dataclasses
from typing import Any

from calibration_core.cell import Cell
from calibration_core.identification.geometry.identifiability import geometry_terms, pose_information
from calibration_core.identification.geometry.terms import names_of
from calibration_core.identification.result.estimate import Unidentified
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.planning.geometry import InformationOf, PoseExpectation, make_pose_plan
from calibration_core.planning.loaded import PlanningRules
from calibration_core.planning.optimal_design.criteria import CRITERIA
from calibration_core.planning.plans.plan import Plan
from calibration_core.planning.route import Duration
from calibration_core.report.document import Column, Facts, Section, Table
from calibration_core.report.documents.clearance import clearance
from calibration_core.report.rounding import spread
from calibration_core.timeseries import Float2D, Float3D


@dataclasses.dataclass(frozen=True)
class GeometryExpectation:
    """What a plan for frames and geometry promises, and what it cannot tell.

    Attributes:
        expected: Of the parameters that are determined.
        hidden: Those that stay nominal, and why.
    """

    expected: PoseExpectation
    hidden: tuple[Unidentified, ...]

    def taking(self, duration: Duration, unclear_moves: int) -> GeometryExpectation:
        """Return the promise of a plan to which other phases were added."""
        expected = dataclasses.replace(self.expected, duration=duration, unclear_moves=unclear_moves)
        return dataclasses.replace(self, expected=expected)


def plan_geometry(
    cell: Cell,
    parameters: ModelParameters,
    rules: PlanningRules,
    *,
    configurations: int,
    spares: float,
    seed: int,
    task: Float2D | None = None,
) -> tuple[Plan, GeometryExpectation]:
    """Make a plan for frames and geometry.

    Raises:
        InputError: See `make_pose_plan`.
    """
    chain = chain_of(cell).corrected(parameters.geometry)
    hidden: tuple[Unidentified, ...] = ()

    def information_in(q: Float2D) -> tuple[tuple[str, ...], InformationOf]:
        nonlocal hidden
        terms, hidden = geometry_terms(chain, cell, parameters, q)

        def report_progress(rows: Float2D) -> Float3D:
            return pose_information(chain, cell, parameters, rows, terms)

        return names_of(terms), report_progress

    plan, expected = make_pose_plan(
        cell, information_in, configurations=configurations, spares=spares, rules=rules, seed=seed,
        parameters=parameters, task=task,
    )  # fmt: skip
    return plan, GeometryExpectation(expected, hidden)


def geometry_result(found: GeometryExpectation) -> dict[str, Any]:
    """Return the promise as a part of result.json: standard deviations in m or rad by name."""
    expected = found.expected
    return {
        "criterion": expected.criterion,
        "efficiency": expected.efficiency,
        "observability": dataclasses.asdict(expected.observability),
        "duration": expected.duration.named,
        "unclear_moves": expected.unclear_moves,
        "unjudged": list(expected.unjudged),
        "std": dict(zip(expected.names, expected.std.tolist(), strict=True)),
        "not_identifiable": [_name(one) for one in found.hidden],
    }


def _name(hidden: Unidentified) -> str:
    """Return the parameter that stays nominal, the first of its combination."""
    return next(iter(hidden.combination))


def geometry_section(found: GeometryExpectation) -> Section:
    """Return the section of the report."""
    expected = found.expected
    share = "nothing certifies an optimum"
    if expected.efficiency is not None:
        share = f"at least {100 * expected.efficiency:.1f} % of what any choice could reach"
    facts = Facts(
        (
            ("Criterion", CRITERIA[expected.criterion].text),
            ("Certificate", share),
            ("Condition number", f"{expected.observability.condition:.1f} (5.4, 1)"),
            ("Observability index (5.4, 2)", f"{expected.observability.index:.3g}, per posture"),
            ("Duration", f"about {expected.duration.total / 60:.0f} minutes without spares"),
            ("Clearance", clearance(expected.unclear_moves, expected.unjudged)),
            ("Stay nominal", ", ".join(map(_name, found.hidden)) or "none"),
        )
    )
    rows = tuple((name, spread(1e6 * float(std))) for name, std in zip(expected.names, expected.std, strict=True))
    columns = (Column("Parameter", "left"), Column("Expected standard uncertainty [µm, µrad]"))
    note = "Lengths in µm, angles in µrad; all parameters fitted together, for the stated noise of the tracker."
    table = Table("Expected uncertainty of frames and geometry", columns, rows, note)
    return Section("Frames and geometry", "5.4, 7.2", (facts, table))


def geometry_summary(found: GeometryExpectation) -> str:
    """Return what came out, in a few lines."""
    expected = found.expected
    share = "" if expected.efficiency is None else f", certainly at least {100 * expected.efficiency:.1f} % attainable"
    hidden = ", ".join(map(_name, found.hidden)) or "none"
    return (
        f"{len(expected.names)} parameters of frames and geometry{share}; condition number "
        f"{expected.observability.condition:.1f}\nstay nominal: {hidden}\n"
        f"{clearance(expected.unclear_moves, expected.unjudged)}"
    )
