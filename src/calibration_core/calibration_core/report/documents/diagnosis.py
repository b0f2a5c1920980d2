"""The report of a diagnosis: what was left out, where, how sure, how much better, and what to measure next."""

from __future__ import annotations

import datetime as dt

from calibration_core.cell import Cell
from calibration_core.diagnosis.result.finding import Diagnosis, Finding
from calibration_core.model.effects.words import effect_sentence
from calibration_core.report.content import date_of_test
from calibration_core.report.diagnosis_summary import headline, used_text
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
from calibration_core.report.results.diagnosis import further_files
from calibration_core.report.results.traffic_light import Light
from calibration_core.report.rounding import fixed, padded, significant
from calibration_core.report.sections.diagnosis import (
    comparison_blocks,
    finding_blocks,
    gain_blocks,
    next_blocks,
    stiffness_blocks,
    story,
    where_blocks,
)
from calibration_core.report.sections.procedure import counts_text, load_text, safety_limit
from calibration_core.report.sections.records import exclusion_section, given_model, traceability_section
from calibration_core.report.sections.together import together_blocks
from calibration_core.report.view3d.view import View
from calibration_core.report.writing.rendering import document_number

STATEMENT = (
    "A finding says that the recording is explained better with the effect than without, on data that the fit did not "
    "see; it does not say that nothing else could be the cause. What the recording cannot distinguish is listed with "
    "every finding. The residuals of the standard's model, the noise and the measuring equipment stand in the report "
    "of calibration identify for the same recording."
)


def diagnosis_document(
    found: Diagnosis,
    cell: Cell,
    result: bytes,
    light: Light,
    view: View | None = None,
    day: dt.date | None = None,
) -> Document:
    """Build the report of a diagnosis.

    Args:
        found: The diagnosis.
        cell: The cell.
        result: The bytes of result.json, for the report's number.
        light: The traffic light of the result.
        view: What the steps from a simulation to the noise leave, in space; None without such steps.
        day: Date of evaluation; today (UTC) if not given.
    """
    day = day or dt.datetime.now(dt.UTC).date()
    null = found.identification
    by = " by the fit of the joint stiffness alone" if null.kind == "loaded" else ""
    sections = []
    if null.together is not None:
        sections.append(Section("Recordings evaluated together", "", together_blocks(null.together, null.stiffness)))
    for compared in found.comparisons:
        title = "Recording and simulation" if null.together is None else f"{compared.recording} and its simulation"
        sections.append(Section(title, "", comparison_blocks(compared, view)))
    sections.append(Section("Where recording and model differ", "", where_blocks(found)))
    sections += [
        Section(f"Finding {number}: {_title(finding)}", "", finding_blocks(finding))
        for number, finding in enumerate(found.findings, start=1)
    ]
    sources = traceability_section(cell, null.readings.provenance, further_files(found), found.remarks)
    sections += [
        Section("How much better", "", gain_blocks(found)),
        Section("What remains", "", (Paragraph(found.rest.text),)),
        Section("Anomalies", "", _anomalies(found)),
        Section("What to measure next", "", next_blocks(found, cell.prismatic)),
        Section("Joint stiffness in the extended model", "", stiffness_blocks(found)),
        *([Section("What this kind of recording cannot show", "", (Items(found.aliases),))] if found.aliases else []),
        Section("Readings not used", "", exclusion_section(null, by, readmits=False)),
        Section("Input and software", "", sources),
    ]
    document = Document(
        number=document_number(result),
        title="Diagnosis of model and recording",
        subtitle="Elastostatic compliance calibration according to CWA 17384",
        facts=_facts(found, cell, day),
        verdict=_verdict(found, light),
        front=(_overview(found), story(found)),
        sections=tuple(sections),
        signatures=("Evaluated by", "Approved by"),
        statement=STATEMENT,
    )
    return numbered(cleaned(document))


def _facts(found: Diagnosis, cell: Cell, day: dt.date) -> Facts:
    null = found.identification
    provenance = null.readings.provenance
    return Facts((
        ("Industrial robot", cell.robot.name),
        ("Cell", cell.name),
        ("Date of the test", date_of_test(provenance.start)),
        ("Date of evaluation", f"{day:%Y-%m-%d}"),
        ("Recording", f"{provenance.path} ({provenance.kind})"),
        ("Extent", counts_text(null)),
        ("Applied load", load_text(null, cell)),
        ("Safety-rated speed limit", safety_limit(cell)),
        *given_model(null),
    ))  # fmt: skip


def _verdict(found: Diagnosis, light: Light) -> Verdict:
    sentence = headline(found)
    residual = f"{_um(found.rms_before)} per coordinate without the findings, {_um(found.rms_after)} with them"
    residual += used_text(found)
    lines = [
        *light.rows,
        ("Result", sentence[0].upper() + sentence[1:]),
        ("Residual", residual),
        ("Left out", f"configurations not in the fit: {_um(found.held_out_before)} to {_um(found.held_out_after)}"),
        ("Noise", f"{_um(found.noise)} per coordinate are taken for noise"),
    ]
    if found.anomalies:
        kinds = dict.fromkeys(anomaly.kind.replace("_", " ") for anomaly in found.anomalies)
        lines.append(("Anomalies", ", ".join(kinds)))
    return Verdict(light.headline, tuple(lines), light.usable)


def _overview(found: Diagnosis) -> Block:
    if not found.findings:
        return Paragraph("No effect of the catalogue stands out of the noise and of many small effects.")
    rows = tuple(
        (
            _title(finding),
            significant(1e6 * finding.magnitude, 3),
            fixed(100 * finding.held_out_gain, 0),
            str(len(finding.cannot_be_told_from)),
        )
        for finding in found.findings
    )
    columns = (
        Column("What the model lacks", "left", wide=True),
        Column("Size [µm]"),
        Column("Error on data left out falls by [%]"),
        Column("Other explanations"),
    )
    note = (
        "Size: root mean square of the movement of the measured points that the effect causes. Error: squared, on "
        "configurations that the fit did not use. Other explanations: effects or places that do as well here."
    )
    return Table("Findings", columns, padded(rows), note)


def _anomalies(found: Diagnosis) -> tuple[Block, ...]:
    if not found.anomalies:
        return (Paragraph("None was found."),)
    return (Items(tuple(f"{a.kind.replace('_', ' ')}: {a.text}" for a in found.anomalies)),)


def _title(finding: Finding) -> str:
    words = effect_sentence(finding.effect, finding.location)
    return words[0].upper() + words[1:] + ("" if finding.location else "; where is not decided")


def _um(value: float) -> str:
    return f"{1e6 * value:.1f} µm"
