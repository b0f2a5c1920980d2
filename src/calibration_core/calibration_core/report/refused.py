"""The answer where the input is not what it claims to be: what is seen, and how to put it right; no stiffness table."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.report.command_result import command_result, input_record
from calibration_core.report.document import Document, Facts, Paragraph, Section, Verdict, cleaned, numbered
from calibration_core.report.light import with_light
from calibration_core.report.rendering import document_number
from calibration_core.report.rounding import counted
from calibration_core.report.sections.records import traceability_section
from calibration_core.timeseries import Readings

STATEMENT = (
    "Nothing was identified. A stiffness from readings with the wrong sign, unit, axes or order would look like any "
    "other, and be wrong."
)


def refused_result(
    command: str,
    cell: Cell,
    readings: Readings,
    found: Sequence[InputAnomaly],
    inputs: Mapping[str, Mapping[str, str]],
) -> dict[str, Any]:
    """Return the content of result.json.

    Args:
        command: Name of the command.
        cell: The cell.
        readings: The recording.
        found: What is wrong with its input.
        inputs: Role -> file -> SHA-256 of input files besides recording and cell.
    """
    steps = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    configurations = len(np.unique(readings.configuration))
    recording = {
        "file": readings.provenance.path,
        "configurations": configurations,
        "steps": len(steps),
        "points": list(readings.points),
        "loaded": readings.wrench is not None and len(steps) > configurations,
        "readings": len(readings),
    }
    content = command_result(
        command,
        cell,
        recording,
        anomalies=[anomaly.record() for anomaly in found],
        unexplained={"rms": 0.0, "significant": True, "where": {}},
        notes=[vars(note) for note in readings.notes],
        input=input_record(cell, readings.provenance, inputs),
    )
    return with_light(content)


def refused_summary(found: Sequence[InputAnomaly]) -> str:
    """Return what is wrong and what to put right, a few lines."""
    lines = [f"not usable: {found[0].remedy}"]
    lines += [f"anomaly: {anomaly.kind}: {anomaly.text}" for anomaly in found]
    return "\n".join([*lines, "no stiffness is stated from such input"])


def refused_document(
    cell: Cell,
    readings: Readings,
    found: Sequence[InputAnomaly],
    result: bytes,
    inputs: Mapping[str, Mapping[str, str]],
) -> Document:
    """Build the report; arguments as for `refused_result`, `result` being its bytes."""
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
        verdict=Verdict("Not usable: the input has to be put right first", lines),
        front=(),
        sections=(seen, Section("Input and software", "", traceability_section(cell, readings.provenance, inputs))),
        signatures=("Evaluated by",),
        statement=STATEMENT,
    )
    return numbered(cleaned(document))
