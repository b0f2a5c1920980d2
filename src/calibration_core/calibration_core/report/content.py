"""Everything the report says, built once from the answer; HTML and PDF print the same value."""

from __future__ import annotations

import datetime as dt
import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.result.estimate import Identification
from calibration_core.model.effects.words import effect_sentence
from calibration_core.report.document import (
    Block,
    Document,
    Facts,
    Paragraph,
    Section,
    Verdict,
    cleaned,
    numbered,
)
from calibration_core.report.extent import without_load_note
from calibration_core.report.results.diagnosis import identified_dict
from calibration_core.report.results.result import result_json, tested
from calibration_core.report.results.standard import standard_rows
from calibration_core.report.results.traffic_light import Light, light_of
from calibration_core.report.results.verdict import ResidualVerdict, rest
from calibration_core.report.rounding import counted, length_unit, listed, shortened, significant, spread
from calibration_core.report.sections import (
    phases,
    procedure,
    records,
    residuals,
    standard,
    stiffness,
    together,
    uncertainty,
)
from calibration_core.report.shown import shown
from calibration_core.report.summary import positions_lines
from calibration_core.report.writing.rendering import document_number

TITLE = "Elastostatic compliance calibration"
STATEMENT = (
    "The results hold for the robot, the configurations and the loads stated here. The uncertainties are "
    "those of the fit: they "
    "contain the noise of the tracker and wrench readings, not the compliance of end effector, load device "
    "or foundation, "
    "nor errors of parameters that were kept nominal."
)
REFERENCE = (
    "The recording holds displacements: the first step of every configuration and point is the reference, its residual "
    "is zero by definition and is not counted here."
)
SIGNATURES = ("Measured by", "Evaluated by", "Approved by")


def build(
    identification: Identification,
    cell: Cell,
    evaluated: dt.date | None = None,
    searched: Diagnosis | None = None,
) -> Document:
    """Build the report of an identification (CWA 17384, clause 8).

    Args:
        identification: The answer.
        cell: The cell it belongs to.
        evaluated: Date of evaluation; today (UTC) if not given.
        searched: What the search for missing physics says; None where there was none.
    """
    content = identified_dict(identification, searched, cell)
    result, left = identification, rest(identification)
    day = evaluated or dt.datetime.now(dt.UTC).date()
    sections = _sections(result, cell, left)
    front: tuple[Block, ...] = (Paragraph(_no_stiffness(result)),)
    if result.stages and not result.stiffness:
        front = (*front, *uncertainty.stage_blocks(result))
    if result.stiffness:
        named = (
            () if searched is None else tuple(effect_sentence(one.effect, one.location) for one in searched.findings)
        )
        table = stiffness.table_2(result, cell)
        unexplained = searched is not None and searched.rest.significant
        omitted = stiffness.left_out(result, named, unexplained=unexplained)
        front = (table, *omitted, stiffness.drawing_of(result, cell))
    document = Document(
        number=document_number(result_json(content)),
        title=TITLE,
        subtitle="Test report according to CWA 17384",
        facts=_facts(result, cell, day),
        verdict=_verdict(result, left, light_of(content)),
        front=(*front, Paragraph(_where(sections, dated=bool(result.readings.provenance.start)))),
        sections=sections,
        signatures=SIGNATURES,
        statement=STATEMENT,
    )
    return numbered(cleaned(document))


def date_of_test(start: str) -> str:
    """Return the date of the test as printed, from the ISO 8601 start of the recording."""
    if not start:
        return "not stated in the recording"
    try:
        moment = dt.datetime.fromisoformat(start)
    except ValueError:
        return start
    return f"{moment:%Y-%m-%d}" if len(start) <= 10 else f"{moment:%Y-%m-%d %H:%M} UTC"


def _facts(result: Identification, cell: Cell, day: dt.date) -> Facts:
    provenance = result.readings.provenance
    rows = [
        ("Industrial robot", cell.robot.name),
        ("Cell", cell.name),
        ("Date of the test", date_of_test(provenance.start)),
        ("Date of evaluation", f"{day:%Y-%m-%d}"),
        ("Recording", f"{provenance.path} ({provenance.kind})"),
        ("Extent", procedure.counts_text(result)),
        ("Applied load", procedure.load_text(result, cell)),
    ]
    return Facts((*rows, *records.given_model(result)))


def _verdict(result: Identification, left: ResidualVerdict, light: Light) -> Verdict:
    known = [joint for joint in result.stiffness if joint.identifiable]
    rigid = [joint.joint for joint in result.stiffness if not (joint.identifiable or joint.open)]
    total = len(result.stiffness) - len(rigid) or len(result.model.joints)
    lines: list[tuple[str, str]] = []
    if known:
        headline = f"Joint stiffness identified: {len(known)} of {counted(total, 'joint')}"
        worst = max(known, key=lambda joint: joint.std / joint.value if joint.value else math.inf)
        share = spread(100 * worst.std / worst.value)
        lines.append(("Uncertainty", f"largest relative standard uncertainty {share} % ({shortened(worst.joint)})"))
    else:
        fitted = [parameter for parameter in result.parameters if parameter.fitted]
        headline = "Joint stiffness not identified"
        if fitted:
            headline += (
                f"; {len(fitted)} of {counted(len(result.parameters), 'parameter')} of frames and geometry identified"
            )
    open_joints = [joint.joint for joint in result.stiffness if joint.open]
    if open_joints:
        lines.append(("Not identifiable", listed(open_joints)))
    if rigid:
        lines.append(("Declared rigid, not asked for", listed(rigid)))
    lines.append(("Residual", stiffness.rest_text(left)))
    unit = length_unit(result.fit.held_out_mean_after)
    mean, largest = (
        f"{spread(length * unit.factor)} {unit.name}"
        for length in (result.fit.held_out_mean_after, result.fit.held_out_max_after)
    )
    what = "positions" if result.kind == "absolute" else "deflections"
    prediction = f"{what} of configurations left out of the fit are predicted to {mean} on average, {largest} at worst"
    lines.append(("Prediction", f"{prediction} (3-D)"))
    lines += [("Positions", line.removeprefix("positions, ")) for line in positions_lines(result)]
    if result.preconditions:
        failed = [item.requirement for item in result.preconditions if item.met is False]
        text = procedure.requirement_text(result.preconditions)
        lines.append(("Requirements", text + (f"; not met: {'; '.join(failed)}" if failed else "")))
    excluded = int(np.count_nonzero(result.residuals.excluded))
    used = len(result.readings) - excluded
    lines.append(
        (
            "Readings",
            f"{used:,} of {len(result.readings):,} used" + (f", {excluded:,} set aside and named" if excluded else ""),
        )
    )
    if result.noise.understated:
        lines.append(
            ("Noise", f"claim understated; uncertainties are widened by a factor {significant(result.noise.scale, 3)}")
        )
    if left.significant:
        headline += "; the residual is more than noise"
    lines = [*light.rows, ("Result", headline), *lines]
    return Verdict(
        light.headline,
        tuple((label, text if label == "Not identifiable" else text[0].upper() + text[1:]) for label, text in lines),
        light.usable,
    )


def _sections(result: Identification, cell: Cell, left: ResidualVerdict) -> tuple[Section, ...]:
    view = shown(result, cell)
    sections = [
        Section("What the recording determines", "8", stiffness.limits(result)),
        Section("Agreement of model and recording", "", stiffness.fit_section(result, cell, left)),
        *phases.phase_sections(result),
    ]
    if result.together is not None:
        sections.insert(
            0, Section("Recordings evaluated together", "", together.together_blocks(result.together, result.stiffness))
        )
    if result.decoupled is not None:
        sections.append(Section("Arm and wrist", "5.2", phases.decoupled_blocks(result.decoupled)))
    if result.stages and result.stiffness:
        sections.append(Section("Stages of the identification", "7", uncertainty.stage_blocks(result)))
    sections.append(Section("Test parameters", "8 f)", procedure.parameters(result, cell)))
    if result.preconditions:
        sections.append(Section("Requirements of the standard", "5", procedure.requirements(result.preconditions)))
    sections += [
        Section("Measuring equipment", "8 e)", procedure.equipment(cell)),
        Section("Operating space", "8 g)", procedure.operating_space(result.space)),
        Section(
            "Measurement configurations",
            "8 d)",
            procedure.configurations(
                result.space.configuration, result.space.q, cell.prismatic, without_load_note(result.readings)
            ),
        ),
        Section("Residuals", "", _residual_blocks(view, cell)),
        Section("Noise", "5.3", uncertainty.noise_section(view)),
        Section("Condition and correlation", "5.4", uncertainty.correlation_section(result)),
    ]
    if result.parameters:
        sections.append(
            Section("Frames, points and geometry", "7.1 to 7.5", uncertainty.parameter_section(result.parameters))
        )
    if result.standard is not None and standard_rows(result.standard, cell):
        blocks = standard.standard_section(result.standard, cell)
        sections.append(Section("Base frame, joint axes and wrist centre", "7.1 to 7.3", blocks))
    sections += [
        Section("Readings not used", "", records.exclusion_section(result)),
        Section("Anomalies and remarks", "", records.remark_section(result)),
        Section(
            "Input and software", "", records.traceability_section(cell, result.readings.provenance, tested(result))
        ),
    ]
    return tuple(sections)


def _where(sections: tuple[Section, ...], *, dated: bool) -> str:
    """Return where the information stands that clause 8 asks for, and whether the recording has a date."""
    place = {section.clause: i + 1 for i, section in enumerate(sections)}
    return (
        f"Information asked for by CWA 17384, clause 8: a) reference, b) date{'' if dated else ' (not recorded)'} and "
        "c) robot on this page; "
        f"d) configurations in section {place['8 d)']}; e) equipment in section {place['8 e)']}; "
        f"f) parameters in section {place['8 f)']}; g) operating space in section {place['8 g)']}."
    )


def _residual_blocks(view: Identification, cell: Cell) -> tuple[Block, ...]:
    blocks = residuals.residual_section(view)
    if view.kind == "loaded" and cell.measurements.points == "displacement":
        return (Paragraph(REFERENCE), *blocks)
    return blocks


def _no_stiffness(result: Identification) -> str:
    reasons = [stage.reason for stage in result.stages if stage.name == "elasticity" and not stage.kept]
    why = f" Elasticity was examined and not kept: {reasons[0]}." if reasons else ""
    if result.kind == "absolute":
        return (
            "Table 2 of the standard stays empty: the recording holds one position per configuration under "
            "the robot's own weight, "
            "no loaded and unloaded pairs." + why
        )
    return "Table 2 of the standard stays empty: this recording determines no joint stiffness." + why
