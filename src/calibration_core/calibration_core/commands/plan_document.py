"""The plan's report: what is to be measured, with which loads, and what may be expected of it."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.estimate import OperatingSpace, Precondition
from calibration_core.identification.preconditions import MIN_CONFIGURATIONS, NEAR_SINGULAR, TEST_UNCERTAINTY_RATIO
from calibration_core.model.chain import pose_matrix
from calibration_core.model.instruments import tracker_covariance
from calibration_core.procedure.criteria import CRITERIA
from calibration_core.procedure.plan import Expected, Plan, PlannedConfiguration
from calibration_core.report.document import (
    Block,
    Column,
    Document,
    Facts,
    Paragraph,
    Section,
    Table,
    Verdict,
    cleaned,
    numbered,
)
from calibration_core.report.rendering import document_number
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
    subscript,
)
from calibration_core.report.sections.procedure import (
    configurations,
    equipment,
    operating_space,
    rated_force,
    requirement_text,
    requirements,
)
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.sections.stiffness import symbol
from calibration_core.timeseries import Float1D, Float2D

SPARE_SHARE = 0.5  # CWA 17384, 5.1
STATEMENT = (
    "The expected uncertainties hold for the nominal model and for instruments as good as stated; they contain no "
    "compliance besides the joints', and no gross errors. Reachability was judged by joint limits, a floor, the arm's "
    "own outline and the line of sight to the tracker: it is no collision check of the cell. Every motion is to be "
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
        Section("Manipulator configurations", "8 d)", configurations(*plan.table1(), _spare_note(plan))),
        Section("Loads", "5.1, 7.6", _loads(plan, cell)),
        Section("Start-up cycle and reference", "5.1, 5.2", _cycle(plan)),
        Section("Measuring equipment", "5.3", equipment(cell)),
        Section("Input and software", "", traceability_section(cell, None, inputs)),
    ]
    document = Document(
        number=document_number(result),
        title="Measurement plan",
        subtitle="Elastostatic compliance calibration according to CWA 17384",
        facts=_facts(plan, cell, day),
        verdict=_verdict(plan, cell, space, demands),
        front=front,
        sections=tuple(sections),
        signatures=("Planned by", "Approved by"),
        statement=STATEMENT,
    )
    return numbered(cleaned(document))


def plan_requirements(plan: Plan, cell: Cell, space: OperatingSpace) -> tuple[Precondition, ...]:
    """Check what the standard demands of a plan."""
    count, spares = len(plan.primary), len(plan.spares)
    largest, rated = _full_pulls(plan.configurations), rated_force(cell)
    worst = int(np.argmin(space.singularity))
    nearest = float(space.singularity[worst])
    near = f"nearest: configuration {int(space.configuration[worst])}, smallest singular value {nearest:.3f}"
    expected = plan.expected
    apart = "not stated" if expected is None else f"{1e3 * expected.spacing:.0f} mm"
    demands = [
        Precondition(
            "5.1", f"at least {MIN_CONFIGURATIONS} configurations", f"{count} configurations",
            count >= MIN_CONFIGURATIONS,
        ),
        Precondition(
            "5.1", "50 % or more configurations in reserve", f"{spares} spares, {100 * spares / count:.0f} %",
            spares >= SPARE_SHARE * count,
        ),
        Precondition(
            "5.1", "configurations evenly spaced in the operating space",
            f"mean distance from a place of the operating space to the nearest configuration: {apart}", None,
        ),
        Precondition(
            "5.1", f"load at most 100 % of the rated load ({cell.robot.rated_load:g} kg, {rated:.0f} N)",
            f"largest force {largest.max():.0f} N, {100 * largest.max() / rated:.1f} %",
            bool(largest.max() <= 1.0001 * rated),
        ),
        Precondition(
            "5.2", "start-up cycle before the test", f"{counted(len(plan.startup_cycle), 'posture')} planned",
            len(plan.startup_cycle) > 0,
        ),
        *_uncertainty_ratio(cell, space),
        Precondition("6.2", "configurations far from kinematic singularities", near, nearest >= NEAR_SINGULAR),
    ]  # fmt: skip
    return tuple(demands)


def _uncertainty_ratio(cell: Cell, space: OperatingSpace) -> tuple[Precondition, ...]:
    """Compare the expected deflections with the tracker's uncertainty; nothing where one of them is not known."""
    frame = cell.frames.tracker
    if (
        space.deflection is None
        or not np.any(space.deflection)
        or (frame is None and cell.instruments.tracker.sigma is None)
    ):
        return ()
    pose = np.eye(4) if frame is None else pose_matrix(np.array(frame.xyz), np.array(frame.rpy))
    points = (np.concatenate(list(space.points.values())) - pose[:3, 3]) @ pose[:3, :3]
    sigma = float(np.sqrt(np.mean(np.einsum("mii->m", tracker_covariance(cell, points))) / 3))
    size = float(np.sqrt(np.mean(np.sum(space.deflection**2, axis=1))))
    ratio = size / (2 * np.sqrt(2) * sigma)
    found = f"1:{ratio:.0f} (expected deflection {spread(1e3 * size)} mm rms under the full pull)"
    met = bool(ratio >= TEST_UNCERTAINTY_RATIO)
    return (Precondition("5.3", "test uncertainty ratio not lower than 1:5", found, met),)


def _facts(plan: Plan, cell: Cell, day: dt.date) -> Facts:
    steps = len(plan.primary[0].steps)
    pulls = _full_pulls(plan.configurations)
    share = 100 * float(pulls.max()) / rated_force(cell)
    rows = [
        ("Industrial robot", cell.robot.name),
        ("Cell", cell.name),
        ("Date of planning", f"{day:%Y-%m-%d}"),
        ("Configurations", f"{len(plan.primary)} to measure, {len(plan.spares)} in reserve (spares)"),
        ("Load steps", f"{steps} per configuration, the first unloaded"),
        ("Applied load", f"oblique pulls up to {pulls.max():,.0f} N, {share:.0f} % of the rated load"),
        ("Measurement points", f"{len(cell.points)}: {', '.join(shortened(name) for name in cell.points)}"),
    ]
    return Facts(tuple(rows))


def _verdict(plan: Plan, cell: Cell, space: OperatingSpace, demands: tuple[Precondition, ...]) -> Verdict:
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
    return Verdict(headline, tuple((label, text[0].upper() + text[1:]) for label, text in lines))


def _motion(plan: Plan) -> str:
    assert plan.expected is not None  # noqa: S101 - asked for only then
    text = f"about {plan.expected.travel:.0f} s between the configurations at the planned joint speed"
    unclear = plan.expected.unclear_moves
    if not unclear:
        return text + "; every straight path in joint space is clear of floor and arm"
    return f"{text}; {counted(unclear, 'motion comes', 'motions come')} near floor or arm and must be led around"


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
        told = bool(np.isfinite(expected.compliance_std[i]))
        compliance = significant(1e9 * float(expected.compliance_std[i])) if told else "cannot be told"
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
        return (Paragraph("The plan states nothing about what it promises."),)
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
        "whose readings tell most about the joints. The certificate compares it with the best that any set of the same "
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


def _full_pulls(planned: tuple[PlannedConfiguration, ...]) -> Float1D:
    """Return the size of each configuration's largest force, N."""
    return np.array([np.linalg.norm(one.steps[:, :3], axis=1).max() for one in planned])


def _loads(plan: Plan, cell: Cell) -> tuple[Block, ...]:
    down = cell.gravity / max(float(np.linalg.norm(cell.gravity)), 1e-12)
    rows = []
    for one in plan.configurations:
        pull = one.steps[int(np.argmax(np.linalg.norm(one.steps[:, :3], axis=1))), :3]
        size = float(np.linalg.norm(pull))
        angle = DASH if size == 0.0 else f"{np.degrees(np.arccos(np.clip(pull @ down / size, -1.0, 1.0))):.1f}"
        rows.append((str(one.number), *(fixed(float(part), 0) for part in pull), f"{size:,.0f}", angle))
    first = plan.primary[0].steps[:, :3]
    full = float(np.linalg.norm(first, axis=1).max())
    levels = np.linalg.norm(first, axis=1) / full if full > 0 else np.zeros(len(first))
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


def _cycle(plan: Plan) -> tuple[Block, ...]:
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
        blocks.append(_postures("Reference configuration", reference.q[None, :], ("reference",)))
    if len(plan.startup_cycle):
        names = tuple(str(i + 1) for i in range(len(plan.startup_cycle)))
        blocks.append(
            Paragraph(
                "The start-up cycle moves every joint through as much of its range as is clear; it is driven before "
                "the measurement and repeated periodically."
            )
        )
        blocks.append(_postures("Start-up cycle", plan.startup_cycle, names))
    return tuple(blocks)


def _postures(caption: str, q: Float2D, names: tuple[str, ...]) -> Table:
    columns = (Column("Posture", "left"), *(Column(f"θ{subscript(i + 1)} [°]") for i in range(q.shape[1])))
    rows = tuple(
        (name, *(fixed(float(angle), 3) for angle in row)) for name, row in zip(names, np.degrees(q), strict=True)
    )
    return Table(caption, columns, rows)
