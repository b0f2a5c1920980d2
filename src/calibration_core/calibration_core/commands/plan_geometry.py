"""`calibration plan --for geometry`: postures for frames and geometry, and what they promise."""

from __future__ import annotations

import dataclasses
from typing import Any

from calibration_core.cell import Cell
from calibration_core.commands.clearance import clearance
from calibration_core.identification.estimate import Unidentified
from calibration_core.identification.pose_information import geometry_terms, pose_information
from calibration_core.identification.terms import names_of
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.procedure.criteria import CRITERIA
from calibration_core.procedure.itinerary import Duration
from calibration_core.procedure.plan import Plan
from calibration_core.procedure.planning import PlanningRules
from calibration_core.procedure.pose_planning import PosePromise, Tell, make_pose_plan
from calibration_core.report.document import Column, Facts, Section, Table
from calibration_core.report.rounding import spread
from calibration_core.timeseries import Float2D, Float3D


@dataclasses.dataclass(frozen=True)
class GeometryPromise:
    """What a plan for frames and geometry promises, and what it cannot tell.

    Attributes:
        promise: Of the parameters that can be told.
        hidden: Those that stay nominal, and why.
    """

    promise: PosePromise
    hidden: tuple[Unidentified, ...]

    def taking(self, duration: Duration, unclear_moves: int) -> GeometryPromise:
        """Return the promise of a plan to which other phases were added."""
        promise = dataclasses.replace(self.promise, duration=duration, unclear_moves=unclear_moves)
        return dataclasses.replace(self, promise=promise)


def plan_geometry(
    cell: Cell,
    parameters: ModelParameters,
    rules: PlanningRules,
    *,
    configurations: int,
    spares: float,
    seed: int,
    task: Float2D | None = None,
) -> tuple[Plan, GeometryPromise]:
    """Make a plan for frames and geometry.

    Raises:
        InputError: See `make_pose_plan`.
    """
    chain = chain_of(cell).corrected(parameters.geometry)
    hidden: tuple[Unidentified, ...] = ()

    def teller(q: Float2D) -> tuple[tuple[str, ...], Tell]:
        nonlocal hidden
        terms, hidden = geometry_terms(chain, cell, parameters, q)

        def tell(rows: Float2D) -> Float3D:
            return pose_information(chain, cell, parameters, rows, terms)

        return names_of(terms), tell

    plan, promise = make_pose_plan(
        cell, teller, configurations=configurations, spares=spares, rules=rules, seed=seed, parameters=parameters,
        task=task,
    )  # fmt: skip
    return plan, GeometryPromise(promise, hidden)


def geometry_result(found: GeometryPromise) -> dict[str, Any]:
    """Return the promise as a part of result.json: standard deviations in m or rad by name."""
    promise = found.promise
    return {
        "criterion": promise.criterion,
        "efficiency": promise.efficiency,
        "observability": dataclasses.asdict(promise.observability),
        "duration": promise.duration.named,
        "unclear_moves": promise.unclear_moves,
        "unjudged": list(promise.unjudged),
        "std": dict(zip(promise.names, promise.std.tolist(), strict=True)),
        "not_identifiable": [_name(one) for one in found.hidden],
    }


def _name(hidden: Unidentified) -> str:
    """Return the parameter that stays nominal, the first of its combination."""
    return next(iter(hidden.combination))


def geometry_section(found: GeometryPromise) -> Section:
    """Return the section of the report."""
    promise = found.promise
    share = "nothing certifies an optimum"
    if promise.efficiency is not None:
        share = f"for certain at least {100 * promise.efficiency:.1f} % of what any choice could reach"
    facts = Facts(
        (
            ("Criterion", CRITERIA[promise.criterion].text),
            ("Certificate", share),
            ("Condition number", f"{promise.observability.condition:.1f} (5.4, 1)"),
            ("Observability index (5.4, 2)", f"{promise.observability.index:.3g}, per posture"),
            ("Duration", f"about {promise.duration.total / 60:.0f} minutes without spares"),
            ("Clearance", clearance(promise.unclear_moves, promise.unjudged)),
            ("Stay nominal", ", ".join(map(_name, found.hidden)) or "none"),
        )
    )
    rows = tuple((name, spread(1e6 * float(std))) for name, std in zip(promise.names, promise.std, strict=True))
    columns = (Column("Parameter", "left"), Column("Expected standard uncertainty [µm, µrad]"))
    note = "Lengths in µm, angles in µrad; all parameters fitted together, for the stated noise of the tracker."
    table = Table("Expected uncertainty of frames and geometry", columns, rows, note)
    return Section("Frames and geometry", "5.4, 7.2", (facts, table))


def geometry_summary(found: GeometryPromise) -> str:
    """Return what came out, in a few lines."""
    promise = found.promise
    share = "" if promise.efficiency is None else f", certainly at least {100 * promise.efficiency:.1f} % attainable"
    hidden = ", ".join(map(_name, found.hidden)) or "none"
    return (
        f"{len(promise.names)} parameters of frames and geometry{share}; condition number "
        f"{promise.observability.condition:.1f}\nstay nominal: {hidden}\n"
        f"{clearance(promise.unclear_moves, promise.unjudged)}"
    )
