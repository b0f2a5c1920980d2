"""The report where the input is not what it claims to be."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence

from calibration_core.cell import Cell
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.report.document import Document, Facts, Paragraph, Section, Verdict, cleaned, numbered
from calibration_core.report.rounding import counted
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.writing.rendering import document_number
from calibration_core.timeseries import Readings

STATEMENT = (
    "Nothing was identified. A stiffness from readings with the wrong sign, unit, axes or order would look like any "
    "other, and be wrong."
)


def refused_document(
    cell: Cell,
    readings: Readings,
    found: Sequence[InputAnomaly],
    result: bytes,
    inputs: Mapping[str, Mapping[str, str]],
) -> Document:
    """Build the report; arguments as for `refused.refused_result`, `result` being its bytes."""
    facts = Facts((
        ("Industrial robot", cell.robot.name),
        ("Cell", cell.name),
        ("Recording", readings.provenance.path),
        ("Evaluated on", f"{dt.datetime.now(dt.UTC).date():%Y-%m-%d}"),
        ("Extent", f"{counted(len(readings), 'reading')}, {counted(len(readings.points), 'measurement point')}"),
    ))  # fmt: skip
    lines = tuple(
        line for anomaly in found for line in (("What is seen", anomaly.text), ("What to do", anomaly.remedy))
    )
    seen = Section("What is wrong with the input", "", tuple(Paragraph(f"{one.kind}: {one.text}.") for one in found))
    document = Document(
        number=document_number(result),
        title="Input not usable",
        subtitle="Evaluation according to CWA 17384, stopped before any identification",
        facts=facts,
        verdict=Verdict("Not usable: the input has to be put right first", lines, "no"),
        front=(),
        sections=(seen, Section("Input and software", "", traceability_section(cell, readings.provenance, inputs))),
        signatures=("Evaluated by",),
        statement=STATEMENT,
    )
    return numbered(cleaned(document))
