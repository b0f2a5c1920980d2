"""The plan's report: what is to be measured, with which loads, and what may be expected of it."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import OperatingSpace, Precondition
from calibration_core.planning.optimal_design.criteria import CRITERIA
from calibration_core.planning.plans.plan import Expected, Plan
from calibration_core.report.document import (
    Block,
    Column,
    Document,
    Facts,
    Items,
    Paragraph,
    Section,
    Table,
    Verdict,
    cleaned,
    numbered,
)
from calibration_core.report.documents.arcs import describe_arcs
from calibration_core.report.documents.clearance import clearance
from calibration_core.report.documents.requirements import full_pulls, plan_requirements
from calibration_core.report.rounding import (
    DASH,
    STIFFNESS,
    counted,
    decimals,
    fixed,
    padded,
    shortened,
    significant,
    spread,
)
from calibration_core.report.sections.procedure import (
    configurations,
    equipment,
    joint_columns,
    joint_values,
    operating_space,
    rated_force,
    requirement_text,
    requirements,
)
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.sections.stiffness import symbol
from calibration_core.report.writing.rendering import document_number
from calibration_core.timeseries import Float2D, Note

STATEMENT = (
    "The expected uncertainties hold for the nominal model and for instruments as good as stated; they contain no "
    "compliance besides the joints', and no gross errors. Collisions were judged with the bodies that URDF and cell "
    "file state, or with capsules around the arm: what these do not contain was not looked for. Every motion is to be "
    "tried at reduced speed before the measurement."
)


def plan_document(
    plan: Plan,
    cell: Cell,
    space: OperatingSpace,
    result: bytes,
    inputs: Mapping[str, Mapping[str, str]],
    *,
    seed: int,
    day: dt.date | None = None,
    further: Sequence[Section] = (),
    notes: Sequence[Note] = (),
    purpose: str = "",
) -> Document:
    """Build the report of a plan.

    Args:
        plan: What was planned.
        cell: The cell.
        space: The operating space of the configurations to measure.
        result: The bytes of result.json, for the report's number.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
        seed: Seed of the search.
        day: Date of planning; today (UTC) if not given.
        purpose: What the plan is for, where it is no calibration; the headline.
        further: Sections after the loads: what other load steps would reveal, or what is promised of the geometry.
        notes: What must be said of the given model.
    """
    day = day or dt.datetime.now(dt.UTC).date()
    demands = plan_requirements(plan, cell, space)
    front: tuple[Block, ...] = _expected_table(plan, cell)
    sections = [
        Section("Choice of the configurations", "5.1, 5.4", _choice(plan, seed)),
        Section(
            "Requirements of the standard", "5", requirements(demands, "Requirements of CWA 17384 on a plan", "plan")
        ),
        Section("Operating space", "8 g)", operating_space(space)),
        Section(
            "Manipulator configurations", "8 d)", configurations(*plan.table1(), cell.prismatic, _spare_note(plan))
        ),
        Section("Loads", "5.1, 7.6", _loads(plan, cell)),
        *further,
        *_arcs(plan, cell),
        Section("Start-up cycle and reference", "5.1, 5.2", _cycle(plan, cell.prismatic)),
        Section("Measuring equipment", "5.3", equipment(cell)),
        Section("Input and software", "", traceability_section(cell, None, inputs, notes)),
    ]
    document = Document(
        number=document_number(result),
        title="Measurement plan",
        subtitle="Elastostatic compliance calibration according to CWA 17384",
        facts=_facts(plan, cell, day),
        verdict=_verdict(plan, cell, space, demands, purpose),
        front=front,
        sections=tuple(sections),
        signatures=("Planned by", "Approved by"),
        statement=STATEMENT,
    )
    return numbered(cleaned(document))


def _facts(plan: Plan, cell: Cell, day: dt.date) -> Facts:
    steps = len(plan.primary[0].steps)
    pulls = full_pulls(plan.configurations)
    share = 100 * float(pulls.max()) / rated_force(cell)
    load = f"oblique pulls up to {pulls.max():,.0f} N, {share:.0f} % of the rated load" if share else "none"
    rows = [
        ("Industrial robot", cell.robot.name),
        ("Cell", cell.name),
        ("Date of planning", f"{day:%Y-%m-%d}"),
        ("Configurations", f"{len(plan.primary)} to measure, {len(plan.spares)} in reserve (spares)"),
        ("Load steps", f"{steps} per configuration, the first unloaded"),
        ("Applied load", load),
        ("Measurement points", f"{len(cell.points)}: {', '.join(shortened(name) for name in cell.points)}"),
    ]
    return Facts(tuple(rows))


def _verdict(plan: Plan, cell: Cell, space: OperatingSpace, demands: tuple[Precondition, ...], purpose: str) -> Verdict:
    expected = plan.expected
    headline = f"{counted(len(plan.primary), 'configuration')} and {counted(len(plan.spares), 'spare')} planned"
    lines = []
    if expected is not None:
        if expected.stiffness_std is not None:
            worst = int(np.argmax(expected.stiffness_std))
            if np.isfinite(expected.stiffness_std[worst]):
                share = spread(100 * float(expected.stiffness_std[worst]))
                headline += f"; every stiffness expected to {share} % or better"
                text = f"largest expected relative standard uncertainty {share} % ({shortened(plan.joints[worst])})"
                lines.append(("Uncertainty", text))
        if expected.unidentifiable:
            names = ", ".join(shortened(plan.joints[i]) for i in expected.unidentifiable)
            lines.append(("Not identifiable", f"from these configurations and loads: {names}"))
        lines.append(
            (
                "Choice",
                f"{_certificate(expected)}; condition number {significant(expected.condition, 3)}",
            )
        )
        lines.append(("Motion", _motion(plan)))
    failed = [item.requirement for item in demands if item.met is False]
    text = requirement_text(demands, "plan")
    lines.append(("Requirements", text + (f"; not met: {'; '.join(failed)}" if failed else "")))
    if space.deflection is not None and np.any(space.deflection):
        size = np.linalg.norm(space.deflection, axis=1)
        text = (
            f"{spread(1e3 * float(size.min()))} to {spread(1e3 * float(size.max()))} mm at {shortened(cell.points[0])}"
        )
        lines.append(("Deflection", f"expected under the full pull: {text}"))
    return Verdict(purpose or headline, tuple((label, text[0].upper() + text[1:]) for label, text in lines))


def _motion(plan: Plan) -> str:
    assert plan.expected is not None  # noqa: S101 - asked for only then
    spent = plan.expected.duration
    text = f"about {plan.expected.travel:.0f} s between the configurations at the planned joint speed"
    if spent:
        text = (
            f"about {spent['total'] / 60:.0f} minutes without spares: {spent['moving'] / 60:.0f} moving at 250 mm/s or "
            f"less, {spent['startup'] / 60:.0f} start-up cycle, {spent['loading'] / 60:.0f} loading, "
            f"{spent['reading'] / 60:.0f} reading"
        )
    return f"{text}; {clearance(plan.expected.unclear_moves, plan.expected.unjudged)}"


def _expected_table(plan: Plan, cell: Cell) -> tuple[Block, ...]:
    expected = plan.expected
    if expected is None:
        return ()
    stated, relative = cell.robot.stiffness, expected.stiffness_std
    rows = []
    for i, joint in enumerate(plan.joints):
        value = std = share = DASH
        if relative is not None and stated is not None and np.isfinite(relative[i]):
            size = float(relative[i]) * stated[i] * STIFFNESS.factor
            value, std = fixed(stated[i] * STIFFNESS.factor, max(decimals(size), 0)), spread(size)
            share = spread(100 * float(relative[i]))
        determined = bool(np.isfinite(expected.compliance_std[i]))
        compliance = significant(1e9 * float(expected.compliance_std[i])) if determined else "not determined"
        rows.append((symbol(i + 1), shortened(joint), value, std, share, compliance))
    columns = (
        Column("Joint", "left"),
        Column("Name", "left", wide=True),
        Column(f"Stiffness, cell file [{STIFFNESS.name}]"),
        Column("Expected standard uncertainty"),
        Column("Relative [%]"),
        Column("Of the compliance [10⁻⁹ rad/(N·m)]"),
    )
    note = "One standard deviation for the nominal model and the stated noise of the instruments, spares left out."
    return (Table("Expected uncertainty of the joint stiffnesses", columns, padded(rows), note),)


def _choice(plan: Plan, seed: int) -> tuple[Block, ...]:
    expected = plan.expected
    if expected is None:
        return (Paragraph("The plan file states no expected uncertainty."),)
    rows = [
        ("Criterion", f"{CRITERIA[expected.criterion].text}, then evenly spread"),
        ("Certificate", _certificate(expected)),
        ("Condition number", f"{significant(expected.condition, 3)} (5.4, 1), stacked Jacobian, relative stiffnesses"),
        *_figures(expected),
        (
            "Spacing",
            f"{1e3 * expected.spacing:.0f} mm from a place of the operating space to the nearest configuration",
        ),
        ("Motion", _motion(plan)),
        ("Seed", f"{seed}; the same seed gives the same plan"),
    ]
    if expected.a_value is not None and expected.e_value is not None:
        rows[3:3] = [
            (
                "Mean uncertainty",
                f"{spread(100 * expected.a_value)} % (root mean square of the relative uncertainties)",
            ),
            ("Worst combination", f"{spread(100 * expected.e_value)} % (worst combination of relative stiffnesses)"),
        ]
    text = (
        "Postures within the joint limits, clear of the floor and of the arm, in the tracker's sight and away from "
        "singularities were drawn at random, each with several oblique pulls. Of these candidates the set was chosen "
        "whose readings say most about the joints. The certificate compares it with the best that any set of the same "
        "number could reach."
    )
    return (Paragraph(text), Facts(tuple(rows)))


def _certificate(expected: Expected) -> str:
    if expected.efficiency is None:
        return "none: the criterion is not concave, so nothing bounds what another choice could reach"
    share = f"for certain at least {100 * expected.efficiency:.1f} %"
    return f"{share} of what any choice among the candidates could reach (criterion {expected.criterion})"


def _figures(expected: Expected) -> list[tuple[str, str]]:
    """Return the standard's further figures of a choice (5.4), where the plan states them."""
    names = {
        "index": "Observability index (5.4, 2)",
        "smallest": "Smallest singular value",
        "noise": "Noise amplification index",
        "trace": "Trace of the sensitivity matrix (5.4, 3)",
    }
    found = expected.observability
    return [(name, f"{significant(found[key], 3)}, per configuration") for key, name in names.items() if key in found]


def _spare_note(plan: Plan) -> str:
    if not plan.spares:
        return "No spares are planned."
    first, last = plan.spares[0].number, plan.spares[-1].number
    numbers = f"No {first} is a spare" if first == last else f"No {first} to {last} are spares"
    return f"{numbers}, the most telling first: measured only in place of a configuration that cannot be measured."


def _loads(plan: Plan, cell: Cell) -> tuple[Block, ...]:
    down = cell.gravity / max(float(np.linalg.norm(cell.gravity)), 1e-12)
    rows = []
    for one in plan.configurations:
        pull = one.steps[int(np.argmax(np.linalg.norm(one.steps[:, :3], axis=1))), :3]
        size = float(np.linalg.norm(pull))
        angle = DASH if size == 0.0 else f"{np.degrees(np.arccos(np.clip(pull @ down / size, -1.0, 1.0))):.1f}"
        rows.append((str(one.number), *(fixed(float(part), 0) for part in pull), fixed(size, 0), angle))
    first = plan.primary[0].steps[:, :3]
    full = first[int(np.argmax(np.linalg.norm(first, axis=1)))]
    if not full.any():
        return (Paragraph("The robot is measured under its own weight alone; no load is applied."),)
    levels = first @ full / float(full @ full)
    share = ", ".join(f"{100 * level:.0f}" for level in levels)
    columns = (
        Column("No"),
        *(Column(f"F{axis} [N]") for axis in "xyz"),
        Column("Full pull [N]"),
        Column("Off the vertical [°]"),
    )
    return (
        Paragraph(
            f"Every configuration is loaded in {counted(len(first), 'step')}: {share} % of its full pull. The pull "
            "acts at the wrench point; its direction is fixed in base axes (a cable over a pulley, or a guyed weight)."
        ),
        Table("Full pull of every configuration, base axes", columns, tuple(rows)),
    )


def _arcs(plan: Plan, cell: Cell) -> tuple[Section, ...]:
    """Return what the sweeps of single joints are worth; nothing where none is planned."""
    lines = describe_arcs(plan, cell)
    return (Section("Arcs of single joints", "7.1, 7.2", (Items(lines),)),) if lines else ()


def _cycle(plan: Plan, prismatic: tuple[bool, ...]) -> tuple[Block, ...]:
    blocks: list[Block] = []
    reference = plan.reference
    if reference is None:
        blocks.append(Paragraph("No reference configuration is planned."))
    else:
        every = counted(reference.every, "configuration")
        blocks.append(
            Paragraph(
                f"The reference configuration is measured unloaded at the beginning and again after every {every}, "
                "to see drift of tracker, base and temperature."
            )
        )
        blocks.append(_postures("Reference configuration", reference.q[None, :], ("reference",), prismatic))
    if len(plan.startup_cycle):
        names = tuple(str(i + 1) for i in range(len(plan.startup_cycle)))
        blocks.append(
            Paragraph(
                "The start-up cycle moves every joint through as much of its range as is clear; it is driven before "
                "the measurement and repeated periodically."
            )
        )
        blocks.append(_postures("Start-up cycle", plan.startup_cycle, names, prismatic))
    return tuple(blocks)


def _postures(caption: str, q: Float2D, names: tuple[str, ...], prismatic: tuple[bool, ...]) -> Table:
    columns = (Column("Posture", "left"), *joint_columns(prismatic))
    values = joint_values(q, prismatic)
    rows = tuple((name, *(fixed(float(x), 3) for x in row)) for name, row in zip(names, values, strict=True))
    return Table(caption, columns, rows)
