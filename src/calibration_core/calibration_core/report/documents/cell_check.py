"""The report of a check: what the cell file means, with a drawing, what is unusual, and what of a recording matches."""

from __future__ import annotations

import datetime as dt

from calibration_core.outcomes.cell_check import CheckedCell
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
from calibration_core.report.rounding import counted
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.view3d import View
from calibration_core.report.view3d.picture import svg
from calibration_core.report.writing.rendering import document_number

STATEMENT = "Nothing was measured or fitted: this is what the cell file says, and whether that can be."
STATES = {"read": "read", "optional": "not there, not needed", "missing": "missing", "unusable": "cannot be used"}


def check_document(checked: CheckedCell, view: View, result: bytes) -> Document:
    """Build the report."""
    cell = checked.cell
    unusual = tuple(f"{one.place}: found {one.found}, expected {one.expected}." for one in checked.unusual)
    headline = "The cell file can be used" + (f"; {counted(len(unusual), 'value')} to look at" if unusual else "")
    sections = [Section("What the file means", "", (Facts(tuple(checked.words)),))]
    if unusual:
        sections.append(Section("Unusual values", "", (Items(unusual),)))
    if checked.topics or checked.readings:
        sections.append(Section("Recording", "", _recording(checked)))
    sections.append(Section("Input and software", "", traceability_section(cell)))
    document = Document(
        number=document_number(result),
        title="Check of a cell file",
        subtitle="Elastostatic compliance calibration according to CWA 17384",
        facts=Facts((
            ("Industrial robot", cell.robot.name),
            ("Cell", cell.name),
            ("Cell file", str(cell.path)),
            ("Checked on", f"{dt.datetime.now(dt.UTC).date():%Y-%m-%d}"),
        )),
        verdict=Verdict(headline, (("Next step", _next_step(checked)),)),
        front=(_drawing(view),),
        sections=tuple(sections),
        signatures=("Checked by",),
        statement=STATEMENT,
    )  # fmt: skip
    return numbered(cleaned(document))


def _next_step(checked: CheckedCell) -> str:
    if checked.readings:
        return f"Identify the joint stiffness: calibration identify RECORDING --cell {checked.cell.path.name}"
    return "Compare the drawing with the cell; then plan a measurement, or check a recording with the file."


def _drawing(view: View) -> Figure:
    bodies = "" if not view.plain else " The robot is drawn by its joints alone, without the maker's shapes."
    caption = f"The cell as its file describes it: robot at zero joint angles, frames, targets, tracker, boxes.{bodies}"
    return Figure("space", caption, f"{view.name}, seen from the side and above", svg(view), turnable=True)


def _recording(checked: CheckedCell) -> tuple[Block, ...]:
    blocks: list[Block] = []
    if checked.topics:
        columns = (
            Column("What", "left"),
            Column("Topic", "left"),
            Column("State", "left"),
            Column("Found", "left", True),
        )
        rows = tuple((one.role, one.topic, STATES[one.state], one.text) for one in checked.topics)
        blocks.append(Table("Topics of the recording", columns, rows))
    blocks += [Paragraph(f"{line}.") for line in checked.readings]
    return tuple(blocks)
