"""The report of a fleet: types, ranking, what to measure next, and a table of all robots to search and sort."""

from __future__ import annotations

import datetime as dt
import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from calibration_core import __version__
from calibration_core.fleet.figures import distribution_figure, percent
from calibration_core.fleet.next_robot.planning import saving
from calibration_core.fleet.plant import CONSPICUOUS, UNKNOWN, JointState, Plant, PooledQuantity
from calibration_core.fleet.proposals import Proposal
from calibration_core.fleet.recordings.rows import Row
from calibration_core.fleet.series import STIFFNESS
from calibration_core.report.document import (
    Block,
    Column,
    Document,
    Facts,
    Figure,
    Items,
    Paragraph,
    Section,
    Table,
    Verdict,
    cleaned,
    numbered,
)
from calibration_core.report.rounding import DASH, counted, fixed, padded, significant
from calibration_core.report.writing.fleet_page import render_fleet_html
from calibration_core.report.writing.output import REPORT_HTML, REPORT_PDF, Content
from calibration_core.report.writing.pdf import render_pdf
from calibration_core.report.writing.rendering import document_number

RANKED, PROPOSED, FAILURES = 30, 20, 20  # rows that the printed report shows
STATEMENT = (
    "A robot is conspicuous where a stiffness, backlash or hysteresis stands out from its sisters or from its own "
    "past, at a level that a robot like its sisters reaches with a probability of 0.2 %, or where its last diagnosis "
    "names an effect that its sisters do not show."
)


def fleet_report(
    plant: Plant, rows: Sequence[Row], source: str, proposed: Sequence[Proposal], result: bytes
) -> dict[str, Content]:
    """Return `report.html` and `report.pdf`."""
    document = fleet_document(plant, rows, source, proposed, result)
    return {REPORT_HTML: render_fleet_html(document, page_data(plant)), REPORT_PDF: render_pdf(document)}


def fleet_document(
    plant: Plant,
    rows: Sequence[Row],
    source: str,
    proposed: Sequence[Proposal],
    result: bytes,
    day: dt.date | None = None,
) -> Document:
    """Build the printed part; arguments as for `fleet_report`, and the date of evaluation (default: today, UTC)."""
    day = day or dt.datetime.now(dt.UTC).date()
    facts = (
        ("Plant", source),
        ("Recordings", f"{plant.rows}, {plant.failed} of them not usable"),
        ("Robots", f"{len(plant.robots)} of {counted(len(plant.types), 'type')}"),
        ("Date of evaluation", f"{day:%Y-%m-%d}"),
        ("Software", f"calibration_core {__version__}"),
    )
    sections = [
        Section("Ranking", "", _ranking(plant)),
        Section("What to measure next", "", _proposals(proposed)),
        *(Section(f"Type {kind}", "", _type(plant, kind)) for kind in plant.types),
        Section("Recordings that could not be used", "", _failures(rows)),
        Section("Method", "", tuple(Paragraph(text) for text in METHOD)),
    ]
    return numbered(
        cleaned(
            Document(
                number=document_number(result),
                title="Fleet of robots",
                subtitle="Elastostatic compliance calibration according to CWA 17384",
                facts=Facts(facts),
                verdict=_verdict(plant),
                front=(),
                sections=tuple(sections),
                signatures=("Evaluated by", "Approved by"),
                statement=STATEMENT,
            )
        )
    )


POOLING = (
    "The logarithm of a joint's stiffness is the sum of what its type has, what the robot has beside its sisters "
    "(Student's t distribution, so that a robot that is far off is not drawn to them), and the measurement's error. "
    "The population is estimated from the robots that belong together; the raw value stands beside the pooled one "
    "everywhere, and a robot that does not belong is not pooled."
)
REPEATABILITY = (
    "Standard deviations of the measurements are multiplied by the repeatability factor of their type and joint where "
    "the scatter between dates is larger than they say."
)
AGEING = (
    "Over time, a quantity is a straight line between changes. A change or trend is stated where it stands out from "
    "the measurements at the level of all tests of the robot together. A remaining life is stated where the trend "
    "towards the limit is significant: 20 % below the first stiffness, 0.3 mrad of backlash or hysteresis."
)
METHOD = (POOLING, REPEATABILITY, AGEING)


def _verdict(plant: Plant) -> Verdict:
    states = Counter(robot.state for robot in plant.robots)
    lines = [
        (f"{robot.type} {robot.robot}", robot.reasons[0].text)
        for robot in plant.robots[:5]
        if robot.state == CONSPICUOUS
    ]
    if states[UNKNOWN]:
        lines.append(("Not known", f"{counted(states[UNKNOWN], 'robot')} without a usable recording"))
    return Verdict(f"{counted(states[CONSPICUOUS], 'conspicuous robot')} of {len(plant.robots)}", tuple(lines))


def _ranking(plant: Plant) -> tuple[Block, ...]:
    robots = [robot for robot in plant.robots if robot.reasons]
    if not robots:
        return (Paragraph("No robot stands out."),)
    rows = [
        (str(k), robot.type, robot.robot, f"{robot.score:.1f}", "; ".join(one.text for one in robot.reasons[:3]))
        for k, robot in enumerate(robots[:RANKED], start=1)
    ]
    columns = (
        Column("Rank"), Column("Type", "left"), Column("Robot", "left"), Column("Score"),
        Column("Reasons", "left", wide=True),
    )  # fmt: skip
    note = "Score: standard deviations of the strongest reason."
    if len(robots) > RANKED:
        note += f" {len(robots) - RANKED} more robots stand in ranking.csv."
    return (Table("Robots that stand out", columns, padded(rows), note),)


def _proposals(proposed: Sequence[Proposal]) -> tuple[Block, ...]:
    if not proposed:
        return (Paragraph("Nothing is urgent: every robot has a usable recording and none stands out."),)
    columns = (Column("Type", "left"), Column("Robot", "left"), Column("Why", "left", wide=True))
    rows = [(one.type, one.robot, one.why) for one in proposed[:PROPOSED]]
    return (Table("Robots to be measured next, the most urgent first", columns, padded(rows)),)


def _type(plant: Plant, kind: str) -> tuple[Block, ...]:
    states = [state for state in plant.states if state.type == kind]
    stiffness = [state for state in states if state.kind == STIFFNESS]
    found = [one for one in plant.quantities if one.quantity.type == kind]
    blocks: list[Block] = []
    if stiffness:
        caption = f"Stiffness of every joint of every robot of type {kind}; diamonds do not belong to the population"
        blocks.append(Figure(f"type-{kind}", caption, caption, distribution_figure(stiffness)))
        blocks.append(_populations([one for one in found if one.quantity.kind == STIFFNESS]))
        blocks += _saving([one for one in found if one.quantity.kind == STIFFNESS])
    laws = [one for one in found if one.quantity.kind != STIFFNESS and one.shares]
    if laws:
        blocks.append(_laws(laws, states))
    effects = [f"{name}: {100 * share:.0f} % of the robots" for name, share in plant.effects.get(kind, {}).items()]
    if effects:
        blocks += [Paragraph("Effects that the last diagnoses name:"), Items(tuple(effects))]
    return tuple(blocks) or (Paragraph("Nothing usable was measured of this type."),)


def _populations(found: Sequence[PooledQuantity]) -> Table:
    rows = []
    for one in found:
        known = one.population
        robots = str(len(one.quantity.series))
        if known is None:
            rows.append((one.quantity.joint, DASH, DASH, robots, f"{one.quantity.repeatability:.2f}"))
            continue
        rows.append((
            one.quantity.joint, significant(1e-5 * math.exp(known.mean), 4), percent(known.spread),
            f"{known.members} of {robots}", f"{one.quantity.repeatability:.2f}",
        ))  # fmt: skip
    columns = (
        Column("Joint", "left"), Column("Stiffness [10⁵ N·m/rad]"), Column("Spread between robots"),
        Column("Robots that belong"), Column("Repeatability factor"),
    )  # fmt: skip
    return Table("Population of the joint stiffness", columns, padded(rows))


def _saving(found: Sequence[PooledQuantity]) -> list[Block]:
    """Say from where on the population saves configurations."""
    savings = [text for one in found if one.population is not None and (text := saving(one))]
    return [Items(tuple(savings))] if savings else []


def _laws(laws: Sequence[PooledQuantity], states: Sequence[JointState]) -> Table:
    rows = []
    for one in laws:
        values = [s.raw for s in states if (s.kind, s.joint) == (one.quantity.kind, one.quantity.joint)]
        share = next(iter(one.shares.values()))
        rows.append((
            one.quantity.kind, one.quantity.joint, fixed(1e3 * sorted(values)[len(values) // 2], 3),
            fixed(1e3 * max(values), 3), f"{100 * share:.1f} %",
        ))  # fmt: skip
    columns = (
        Column("Quantity", "left"), Column("Joint", "left"), Column("Median [mrad]"), Column("Largest [mrad]"),
        Column("Robots above 0.1 mrad"),
    )  # fmt: skip
    return Table("Backlash and hysteresis", columns, padded(rows))


def _failures(rows: Sequence[Row]) -> tuple[Block, ...]:
    failed = [row for row in rows if not row.measured or row.usable == "no"]
    if not failed:
        return (Paragraph("Every recording could be used."),)
    columns = (Column("Robot", "left"), Column("Date", "left"), Column("Why", "left", wide=True))
    shown = [(f"{row.type} {row.robot}", row.date, row.error or row.reason) for row in failed[:FAILURES]]
    note = f"{len(failed) - FAILURES} more stand in result.json." if len(failed) > FAILURES else ""
    return (Table("Recordings that could not be used", columns, padded(shown), note),)


def page_data(plant: Plant) -> dict[str, Any]:
    """Return what the table of all robots shows: short keys, numbers to four digits."""
    series: dict[tuple[str, str, str, str], Any] = {}
    for one in plant.quantities:
        if one.quantity.kind == STIFFNESS:
            for member in one.quantity.series:
                key = (one.quantity.type, member.robot, STIFFNESS, one.quantity.joint)
                series[key] = [[round(float(x), 3) for x in member.years], [_short(math.exp(v)) for v in member.value]]
    details: dict[str, list[Any]] = {}
    for state in plant.states:
        key = (state.type, state.robot, state.kind, state.joint)
        details.setdefault(f"{state.type}\n{state.robot}", []).append(_detail(state, series.get(key, [])))
    return {
        "robots": [
            [
                robot.type, robot.robot, robot.state, round(robot.score, 1),
                "; ".join(reason.text for reason in robot.reasons) or robot.last_failure,
                len(robot.dates), robot.dates[-1] if robot.dates else "", robot.failures,
                details.get(f"{robot.type}\n{robot.robot}", []),
            ]
            for robot in plant.robots
        ]
    }  # fmt: skip


def _detail(state: JointState, series: Sequence[Any]) -> list[Any]:
    left = state.life
    text = "cannot tell yet"
    if left.known:
        high = "open" if math.isinf(left.high) else f"{left.high:.0f}"
        text = f"{left.months:.0f} ({left.low:.0f} to {high}) months"
    numbers = (state.raw, state.raw_low, state.raw_high, state.pooled, state.pooled_low, state.pooled_high)
    flag = "pooled" if state.is_pooled else "does not belong" if not state.belongs else "not pooled"
    return [state.kind, state.joint, *map(_short, numbers), flag, state.history.cause.replace("_", " "), text, series]


def _short(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None
