"""The report of a comparison."""

from __future__ import annotations

import datetime as dt

import numpy as np

from calibration_core.acceptance.comparison import LAW_LEVEL, STIFFNESS_LEVEL, QuantityChange
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import Schedule
from calibration_core.outcomes.comparison import Compared, described, described_trend, needed_text, words_of
from calibration_core.outcomes.spaces import scheduled_space
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
from calibration_core.report.results.traffic_light import Light
from calibration_core.report.rounding import DASH, counted, fixed, listed, padded, readable_unit, shortened, significant
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.view3d.space import space_view
from calibration_core.report.writing.output import Content
from calibration_core.report.writing.rendering import document_number, rendered

STATEMENT = (
    "A change is stated where it stands out from the uncertainty of both measurements; the level holds for all joints "
    "of all pairs together. Not changed: the 95 % interval lies within the limit. Cannot tell: neither."
)


def comparison_files(found: Compared, result: bytes, light: Light) -> dict[str, Content]:
    """Return `report.html` and `report.pdf`."""
    cell = found.cells[0]
    middle = chain_of(cell).limits.mean(axis=1)[None]
    schedule = Schedule(np.array([1]), np.array([0]), middle, np.zeros((1, 6)))
    space = scheduled_space(schedule, cell, nominal_parameters(cell))
    return rendered(comparison_document(found, result, light), space_view(space, cell))


def comparison_document(found: Compared, result: bytes, light: Light, day: dt.date | None = None) -> Document:
    """Build the report.

    Args:
        found: What came out.
        result: The bytes of result.json, for the report's number.
        light: Its traffic light.
        day: Date of evaluation; today (UTC) if not given.
    """
    day = day or dt.datetime.now(dt.UTC).date()
    cell = found.cells[0]
    facts = (
        ("Industrial robot", cell.robot.name),
        ("Serial number", ", ".join(dict.fromkeys(one.robot.serial or "not stated" for one in found.cells))),
        ("Date of evaluation", f"{day:%Y-%m-%d}"),
        *((f"Measurement {k}", _measured(found, k - 1)) for k in range(1, len(found.measurements) + 1)),
    )
    sections = [
        Section(f"Measurement {k} beside measurement 1", "", _differences(rows))
        for k, rows in enumerate(found.differences, 2)
    ]
    if found.trends:
        sections.append(Section("Trends", "", (Items(tuple(described_trend(one) for one in found.trends)),)))
    sections.append(Section("Method", "", (Paragraph(_method()), *_remarks(found))))
    sections.append(Section("Input and software", "", traceability_section(cell, None, found.inputs)))
    return numbered(
        cleaned(
            Document(
                number=document_number(result),
                title="Comparison of calibrations",
                subtitle="Elastostatic compliance calibration according to CWA 17384",
                facts=Facts(tuple(facts)),
                verdict=_verdict(found, light),
                front=(),
                sections=tuple(sections),
                signatures=("Evaluated by", "Approved by"),
                statement=STATEMENT,
            )
        )
    )


def _measured(found: Compared, k: int) -> str:
    one = found.measurements[k]
    date = "date not known" if one.date is None else f"{one.date:%Y-%m-%d}"
    return f"{one.label}, {date}, {counted(one.configurations, 'configuration')}"


def _verdict(found: Compared, light: Light) -> Verdict:
    changed = [one for rows in found.differences for one in rows if one.verdict == "changed"]
    open_ = [one for rows in found.differences for one in rows if one.verdict == "cannot_tell"]
    headline = f"{counted(len(changed), 'change')} found" if changed else "No change found"
    if not any(found.differences):
        headline = "Nothing to compare"
    lines = [*light.rows, *(("Changed", described(one)) for one in changed[:5])]
    if open_:
        lines.append(("Cannot tell", listed([f"{one.quantity} of {one.location}" for one in open_])))
    return Verdict(headline, tuple(lines), light.usable)


def _differences(rows: tuple[QuantityChange, ...]) -> tuple[Block, ...]:
    stiffness = [one for one in rows if one.quantity == "stiffness"]
    others = [one for one in rows if one.quantity != "stiffness"]
    rigid = "Compliance of rigid joints, b" if any(one.quantity == "compliance" for one in others) else "B"
    blocks: list[Block] = [
        Table(
            "Joint stiffness",
            (
                Column("Joint", "left"), Column("First [10⁵ N·m/rad]"), Column("Second [10⁵ N·m/rad]"),
                Column("Change [%]"), Column("95 % interval [%]"), Column("Verdict", "left", wide=True),
                Column("Configurations"),
            ),
            padded([
                (
                    shortened(one.location), significant(1e-5 * one.first, 4), significant(1e-5 * one.second, 4),
                    fixed(100 * one.change, 1), f"{fixed(100 * one.low, 1)} … {fixed(100 * one.high, 1)}", _words(one),
                    needed_text(one.configurations) or DASH,
                )
                for one in stiffness
            ]),
            NEEDED,
        )
    ]  # fmt: skip
    if others:
        blocks.append(
            Table(
                f"{rigid}acklash, hysteresis and effects",
                (
                    Column("Quantity", "left", wide=True), Column("Location", "left"), Column("First"),
                    Column("Second"),
                    Column("95 % interval of the change"), Column("Unit", "left"), Column("Verdict", "left"),
                    Column("Configurations"),
                ),
                padded([
                    (
                        one.quantity, shortened(one.location), _in(one.unit, one.first), _in(one.unit, one.second),
                        f"{_in(one.unit, one.low)} … {_in(one.unit, one.high)}", readable_unit(one.unit).name,
                        _words(one),
                        needed_text(one.configurations) or DASH,
                    )
                    for one in others
                ]),
                NEEDED,
            )
        )  # fmt: skip
    return tuple(blocks)


def _in(unit: str, value: float) -> str:
    return significant(readable_unit(unit).factor * value)


NEEDED = "Configurations: so many in each measurement would tell a change of the limit; a dash: these are enough."


def _words(one: QuantityChange) -> str:
    return words_of(one) + (f", or {' or '.join(one.or_else)}" if one.or_else else "")


def _method() -> str:
    return (
        "The compliances of both measurements are compared with their full covariances. A robot that ages changes in "
        "few places, so changes are looked for joint by joint, the others as found before. The probability that "
        "anything is said to have changed where nothing has is "
        f"{100 * STIFFNESS_LEVEL:g} % for all stiffnesses of the report together, and "
        f"{100 * LAW_LEVEL:g} % for backlash, hysteresis and effects. These are estimated with all compliances "
        "refitted, each for itself, from the same law and the same reference torque in every recording."
    )


def _remarks(found: Compared) -> tuple[Block, ...]:
    return (Items(found.remarks),) if found.remarks else ()
