"""The certificate of a verification, with what ISO/IEC 17025 asks for, and the report with every detail."""

from __future__ import annotations

import dataclasses
import datetime as dt
from collections.abc import Mapping

import numpy as np

from calibration_core.acceptance.decision import COVERAGE, PROBABILITY, WORDS, guard_factor
from calibration_core.acceptance.verification import SOURCES, Source, Verification
from calibration_core.cell import Cell
from calibration_core.identification.checks.conditions import day_of
from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.outcomes.verification import error_sizes, places, remarks
from calibration_core.report.content import date_of_test
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
from calibration_core.report.rounding import DASH, Unit, counted, fixed, length_unit, padded, spread
from calibration_core.report.sections.procedure import (
    MOST_ROWS,
    NOT_STATED,
    SHOWN_ROWS,
    configurations,
    equipment,
    operating_space,
)
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.writing.rendering import document_number

STATEMENT = (
    "The results relate only to the robot named above, in the state in which it was measured. "
    "No interval of calibration is recommended. Without a signature this document is not valid."
)
OF_LABORATORY = (
    " The certificate shall not be reproduced except in full without the laboratory's written approval. The laboratory "
    "is responsible for all that it states, except what the customer supplied."
)
CERTIFICATE_TITLE, RECORD_TITLE = "Calibration certificate", "Verification record"
OR_SCATTER = ", the reading's scatter where that is larger (A)"
FROM: Mapping[Source, tuple[str, str]] = {
    "tracker": (
        "Laser tracker, one averaged reading",
        f"the tracker's certificate (B){OR_SCATTER}",
    ),
    "wrench": (
        "Force/torque sensor, through the model's compliance",
        f"the sensor's certificate (B){OR_SCATTER}",
    ),
    "geometry": ("Geometry, frames and points of the model", "covariance of the identification (A)"),
    "model": ("Joint compliances and effects of the model", "covariance of the identification (A)"),
    "repeatability": ("Repeatability of the robot at repeated loads", "scatter in this recording (A)"),
}


def certificate_document(
    found: Verification, cell: Cell, result: bytes, inputs: Mapping[str, Mapping[str, str]], day: dt.date | None = None
) -> Document:
    """Build the certificate.

    Args:
        found: What was decided.
        cell: The cell: who, for whom, with what.
        result: The bytes of result.json, for the certificate's number.
        inputs: Role -> file -> SHA-256 of input files besides recording and cell.
        day: Date of issue; today (UTC) if not given.
    """
    day = day or dt.datetime.now(dt.UTC).date()
    sections = (
        Section("Decision rule", "", (Paragraph(_rule(found)),)),
        Section("Uncertainty of measurement", "", _budget(found)),
        Section("Places", "", _places(found)),
        Section("Conditions and method", "", _conditions(found)),
        Section("Measuring equipment and traceability", "8 e)", (*equipment(cell), Paragraph(_traceability(cell)))),
    )
    certified = _is_certificate(cell)
    document = Document(
        number=document_number(result),
        title=CERTIFICATE_TITLE if certified else RECORD_TITLE,
        subtitle="Accuracy of an industrial robot with an identified model, CWA 17384",
        facts=_facts(found, cell, inputs, day),
        verdict=_verdict(found),
        front=_errors(found),
        sections=sections,
        signatures=("Measured and evaluated by", "Authorised by"),
        statement=STATEMENT + (OF_LABORATORY if certified else ""),
    )
    return numbered(cleaned(document))


def _is_certificate(cell: Cell) -> bool:
    """Say whether laboratory, customer and item are known, without which there is no certificate (ISO/IEC 17025)."""
    return bool(cell.certificate.laboratory and cell.certificate.customer and cell.robot.serial)


def _traceability(cell: Cell) -> str:
    """Say through what the results are traceable to the SI, or for which instruments that is not known."""
    used = {"laser tracker": cell.instruments.tracker, "force/torque sensor": cell.instruments.force_torque}
    unknown = [
        role for role, item in used.items() if item is not None and not (item.serial and day_of(item.calibrated))
    ]
    if unknown:
        return (
            "Traceability to the SI is not shown: the cell file does not state serial number and date of calibration "
            f"of the {' and of the '.join(unknown)}."
        )
    return (
        "The results are traceable to the SI through the calibration of the instruments above, whose serial numbers "
        "and dates of calibration the cell file states."
    )


def verification_document(
    found: Verification,
    cell: Cell,
    result: bytes,
    space: OperatingSpace,
    inputs: Mapping[str, Mapping[str, str]],
    light: Light,
    day: dt.date | None = None,
) -> Document:
    """Build the report: the certificate's content with operating space, configurations, input files and software."""
    certificate = certificate_document(found, cell, result, inputs, day)
    further = (
        Section("Operating space", "8 g)", operating_space(space)),
        Section("Encoder angles", "8 d)", configurations(space.configuration, space.q, cell.prismatic)),
        Section("Input and software", "", traceability_section(cell, found.readings.provenance, inputs)),
    )
    lamp = "no" if found.decision == "not_conforming" else light.usable
    verdict = Verdict(certificate.verdict.headline, (*light.rows, *certificate.verdict.lines), lamp)
    report = dataclasses.replace(
        certificate,
        title="Verification of a calibration",
        verdict=verdict,
        sections=(*certificate.sections, *further),
    )
    return numbered(cleaned(report))


def _facts(found: Verification, cell: Cell, inputs: Mapping[str, Mapping[str, str]], day: dt.date) -> Facts:
    readings, names = found.readings, cell.certificate
    rows = (
        ("Laboratory", names.laboratory or NOT_STATED),
        ("Customer", names.customer or NOT_STATED),
        ("Place of measurement", names.place or NOT_STATED),
        ("Operator", names.operator or NOT_STATED),
        ("Industrial robot", cell.robot.name),
        ("Maker", cell.robot.maker or NOT_STATED),
        ("Serial number", cell.robot.serial or NOT_STATED),
        ("Date of the test", date_of_test(readings.provenance.start)),
        ("Date of issue", f"{day:%Y-%m-%d}"),
        ("Recording", f"{readings.provenance.path} ({readings.provenance.kind})"),
        ("Model", ", ".join(f"{name} (SHA-256 {digest[:12]}…)" for name, digest in inputs["model"].items())),
        ("Temperature", _temperature(found)),
    )
    return Facts(rows)


def _temperature(found: Verification) -> str:
    known = found.readings.temperature[np.isfinite(found.readings.temperature)]
    return f"{fixed(float(known.min()), 1)} to {fixed(float(known.max()), 1)} °C" if len(known) else NOT_STATED


def _verdict(found: Verification) -> Verdict:
    unit = length_unit(max(found.tolerance, float(found.size.max())))
    words = WORDS[found.decision]
    headline = f"{words[0].upper()}{words[1:]} with a tolerance of {_size(found.tolerance, unit)}"
    worst = int(np.argmax(found.size))
    expanded = COVERAGE * float(found.uncertainty[worst])
    stated = f"U = {_size(expanded, length_unit(expanded))} (k = {COVERAGE:g})"
    lines = [
        (
            "Largest error",
            f"{_size(float(found.size[worst]), unit)} with {stated}",
        ),
        ("Readings", _counts(found)),
    ]
    if found.fitted:
        lines.append(("Tracker", "its pose was fitted to this recording (six parameters)"))
    return Verdict(headline, tuple(lines))


def _counts(found: Verification) -> str:
    parts = [f"{found.decisions.count(kind):,} {word}" for kind, word in WORDS.items()]
    places_ = len(np.unique(found.readings.configuration))
    return f"{len(found.size):,} at {counted(places_, 'configuration')}: {'; '.join(parts)}"


def _errors(found: Verification) -> tuple[Block, ...]:
    cases = [("before: the cell file's model", found.before), ("after: the identified model", found.error)]
    unit = length_unit(float(found.size.max()))
    rows = [
        (label, DASH, DASH, DASH)
        if error is None
        else (label, *(spread(error_sizes(error)[key] * unit.factor) for key in ("rms", "mean", "max")))
        for label, error in cases
    ]
    columns = (
        Column("Error of the measured point", "left", wide=True),
        Column(f"rms per coordinate [{unit.name}]"),
        Column(f"Mean, 3-D [{unit.name}]"),
        Column(f"Largest, 3-D [{unit.name}]"),
    )
    notes = remarks(found)
    return (
        Table("Errors before and after calibration", columns, padded(rows)),
        *([Items(tuple(notes))] if notes else []),
    )


def _rule(found: Verification) -> str:
    return (
        "ISO 14253-1, a size with an upper limit: a reading conforms where error + g does not exceed the tolerance of "
        f"{1e3 * found.tolerance:g} mm, does not conform where error − g exceeds it, and is undecided between. The "
        f"guard band is g = {guard_factor():.3f} u, for a conformance probability of {100 * PROBABILITY:g} %. The "
        "robot conforms where every reading does, and does not where one reading does not."
    )


def _budget(found: Verification) -> tuple[Block, ...]:
    worst = found.least_certain
    unit = length_unit(float(found.uncertainty[worst]))
    rows = [
        (FROM[source][0], FROM[source][1], spread(float(found.shares[source][worst]) * unit.factor), "1")
        for source in SOURCES
    ]
    total = float(found.uncertainty[worst])
    rows.append(("Combined standard uncertainty u", "", spread(total * unit.factor), ""))
    rows.append(
        (f"Expanded uncertainty U = {COVERAGE:g} u", "coverage about 95 %", spread(COVERAGE * total * unit.factor), "")
    )
    columns = (
        Column("Source", "left", wide=True),
        Column("From (type)", "left", wide=True),
        Column(f"Contribution to u [{unit.name}]"),
        Column("Sensitivity"),
    )
    note = (
        "Of the least certain reading, in the direction of its error; sensitivities are in the contributions. Geometry "
        "and compliances were identified together: their covariance is in the combined uncertainty, so the squares of "
        "the contributions need not add up to it."
    )
    if not found.with_intervals:
        note += " The model file states no covariance: the contributions of geometry and model are not known."
    return (Table("Uncertainty budget", columns, tuple(rows), note),)


def _places(found: Verification) -> tuple[Block, ...]:
    listed = places(found)
    shown = listed if len(listed) <= MOST_ROWS else listed[:SHOWN_ROWS]
    unit = length_unit(float(found.size.max()))
    rows = [
        (
            str(row["configuration"]),
            str(row["step"]),
            str(row["point"]),
            DASH if row["before"] is None else spread(row["before"] * unit.factor),
            spread(row["error"] * unit.factor),
            spread(COVERAGE * row["standard_uncertainty"] * unit.factor),
            WORDS[row["decision"]].partition(" because")[0] + (", outside range" if row["outside_valid_range"] else ""),
        )
        for row in shown
    ]
    columns = (
        Column("Configuration"),
        Column("Step"),
        Column("Point", "left"),
        Column(f"Before [{unit.name}]"),
        Column(f"Error [{unit.name}]"),
        Column(f"U, k = {COVERAGE:g} [{unit.name}]"),
        Column("Decision", "left", wide=True),
    )
    note = "The reading nearest to, or furthest beyond, the tolerance in each configuration."
    if len(shown) < len(listed):
        note += f" First {len(shown)} of {len(listed):,}; all stand in result.json."
    return (Table("Errors by configuration", columns, padded(rows), note),)


def _conditions(found: Verification) -> tuple[Block, ...]:
    readings = found.readings
    load = "none besides the robot's own weight"
    if readings.wrench is not None:
        load = f"up to {float(np.linalg.norm(readings.wrench[:, :3], axis=1).max()):,.0f} N"
    rows = [
        ("Method", "points measured with a laser tracker, predicted from encoder angles and wrench by the model"),
        ("External load", load),
        ("Temperature", _temperature(found)),
        ("Tracker's pose", "fitted to this recording" if found.fitted else "of the model"),
    ]
    rows += [
        (condition.requirement, f"{condition.value} (limit {condition.limit}; clause {condition.clause})")
        for condition in readings.conditions
    ]
    return (Facts(tuple(rows)),)


def _size(value: float, unit: Unit) -> str:
    return f"{spread(value * unit.factor)} {unit.name}"
