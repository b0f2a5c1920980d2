"""What a diagnosis tells a person: where, what, why not something else, how sure, how much better, what next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.comparison.result import Comparison, StepByStep, WaterfallStep
from calibration_core.diagnosis.result.finding import (
    EMPIRICAL,
    Diagnosis,
    Finding,
    FoundParameter,
    ProposedMeasurement,
    evidence_words,
)
from calibration_core.identification.result.tested import PARTS
from calibration_core.model.effects import catalogue
from calibration_core.model.effects.words import effect_sentence, people_unit
from calibration_core.report.diagnosis_summary import improved_lines
from calibration_core.report.document import Block, Column, Facts, Figure, Items, Paragraph, Table
from calibration_core.report.figures.diagnosis import (
    before_after_figure,
    comparison_figure,
    waterfall_figure,
    where_figure,
)
from calibration_core.report.results.diagnosis import extended_joints
from calibration_core.report.rounding import COVERAGE, DASH, counted, decimals, fixed, padded, significant
from calibration_core.report.sections.procedure import joint_columns, joint_values
from calibration_core.report.sections.stiffness import extended_table
from calibration_core.report.view3d.picture import svg
from calibration_core.report.view3d.view import View

MOST_ROWS = 12
MOST_OTHERS = 5
GAIN = "Gain: recorded over simulated."
LOST = "What a format leaves out adds so much, squared, to what the whole model leaves."
STIFFNESS_OF = {"rad/(N*m)": "N·m/rad", "m/N": "N/m"}
CONCERNED = {
    "structure": "the structure (bearings, links, base, tool)",
    "joint law": "how a joint gives way to torque",
    "load chain": "what was measured as load",
    "point chain": "what was measured as position",
    "absolute": "geometry and drives, without external load",
}


def comparison_blocks(compared: Comparison, view: View | None = None) -> tuple[Block, ...]:
    """Return what recording and simulation have in common and what not; in space, too, where there is a view."""
    blocks: list[Block] = [Items(compared.sentences)]
    if compared.differences:
        rows = tuple(
            (d.kind.replace("_", " "), ", ".join(d.location.values()), d.side, "yes" if d.spoils else "no")
            for d in compared.differences
        )
        columns = (
            Column("Difference", "left", wide=True), Column("Place", "left"),
            Column("Disagrees with the cell file", "left"), Column("Spoils the comparison", "left"),
        )  # fmt: skip
        blocks.append(Table("Differences that are no physics", columns, rows))
    channels = tuple(
        (channel.name, significant(channel.rms, 3), people_unit(channel.unit), significant(channel.gain, 4))
        for one in compared.witnesses
        for channel in one.channels
    )
    if channels:
        columns = (Column("Said by both", "left"), Column("rms difference"), Column("Unit", "left"), Column("Gain"))
        blocks.append(Table("Recording beside simulation, one by one", columns, padded(channels), GAIN))
    steps, postures = compared.steps, compared.postures
    if steps is None:
        return tuple(blocks)
    if compared.waterfall:
        blocks += _waterfall(compared)
    if view is not None:
        words = "Recording minus simulation at the largest load, as it is (red) and after the last step (green)."
        blocks.append(Figure("space", words, f"{view.name}, with the difference as arrows", svg(view), turnable=True))
    caption = (
        "Recording minus simulation, in every configuration and step."
        if steps.grid is not None and steps.grid.shape[1] > 1
        else "Recording minus simulation: a) per configuration; b) per step; dashed: the noise of both."
    )
    if compared.pattern:
        blocks.append(Paragraph(compared.pattern))
    blocks.append(Figure("comparison", caption, "Difference per configuration and step", comparison_figure(steps)))
    bends = bool(np.isfinite(steps.slope))
    blocks.append(_largest("Largest differences of recording and simulation", steps, bends=bends))
    if postures is not None:
        blocks.append(_largest("Largest differences of positions, configurations with one step", postures, bends=False))
    return tuple(blocks)


def _waterfall(compared: Comparison) -> list[Block]:
    """Return how the difference becomes the noise, as a figure and with its numbers, and what is handed over."""
    steps, improved = compared.waterfall, compared.improved
    caption = (
        "What is left of the difference after each step; each fits its own numbers and those before it. Dark: of the "
        "configurations in the fit; circles: of configurations left out; diamonds: of the test recording. "
        "Last: the new simulation, as it is."
    )
    columns = (
        Column("Step", "left"), Column("What changes", "left", wide=True), Column("Left [µm]"),
        Column("Not in the fit [µm]"), Column("Test [µm]"), Column("Takes [%]"),
    )  # fmt: skip
    rows = tuple(
        (
            step.name.replace("_", " "),
            step.what,
            *(significant(1e6 * value, 3) for value in (step.rms, step.held_out_rms, step.test_rms)),
            fixed(100 * step.share, 1),
        )
        for step in steps
    )
    note = "Shares are of the squared difference; they add up to 100 %. That of the noise is what is left."
    figure = Figure("waterfall", caption, "From the simulation to the noise", waterfall_figure(compared))
    blocks: list[Block] = [figure, Table("From the simulation to the noise", columns, padded(rows), note)]
    blocks.append(changed_numbers(steps))
    if improved is not None:
        lost = (
            (" with ".join(one.files), "; ".join(one.effects) or DASH, significant(1e6 * one.costs, 3))
            for one in improved.losses
        )
        formats = (Column("Files", "left"), Column("Leave out", "left", wide=True), Column("Costs [µm]"))
        blocks.append(Items(tuple(improved_lines(improved)[:1])))
        blocks.append(Table("The improved simulation for other programs", formats, padded(tuple(lost)), LOST))
    return blocks


def changed_numbers(steps: Sequence[WaterfallStep]) -> Table:
    """Return the numbers that change, with the value before and after, rounded by the uncertainty of the latter."""
    rows = tuple(
        (
            one.name,
            *(
                fixed(value, decimals((one.high - one.low) / (2.0 * COVERAGE)))
                for value in (one.before, one.after, one.low, one.high)
            ),
            people_unit(one.unit),
        )
        for step in steps
        for one in step.changed
        if one.changed
    )
    columns = (
        Column("Number", "left"), Column("Before"), Column("After"), Column("95 % from"), Column("to"),
        Column("Unit", "left"),
    )  # fmt: skip
    note = "Those of which the recording is sure."
    return Table("What changes in the simulator's model", columns, rows, note)


def _largest(title: str, steps: StepByStep, *, bends: bool) -> Table:
    """Return the configurations that differ most; with the size of their deflections where they bend."""
    parts = steps.by_configuration[:MOST_ROWS]
    body = tuple(
        (p.name, significant(1e6 * p.rms, 3), significant(1e6 * p.largest, 3), significant(1e6 * p.measured, 3))
        for p in parts
    )
    columns = (
        Column("Configuration"), Column("rms difference [µm]"), Column("Largest, 3-D [µm]"),
        Column("rms deflection [µm]"),
    )  # fmt: skip
    kept = columns if bends else columns[:-1]
    note = "" if len(parts) == len(steps.by_configuration) else f"The {MOST_ROWS} largest."
    return Table(title, kept, padded([row[: len(kept)] for row in body]), note)


def where_blocks(found: Diagnosis) -> tuple[Block, ...]:
    """Return where recording and model differ, without any hypothesis."""
    if not found.located:
        return (Paragraph("No pattern stands out."),)
    blocks: list[Block] = [Items(found.located)]
    where = found.where
    if where is not None and (where.shares or where.levels or where.dependences):
        left = (
            "a) How much of the residual turns about lines through every joint explain (grey: any axis, black: the "
            "joint's own; framed and bold: the joint that explains most); b) "
            if where.shares
            else ""
        )
        right = (
            "the residual along its direction at full load, by load (line: in proportion)."
            if len(where.levels) > 2
            else "what the residual follows from configuration to configuration."
        )
        caption = left + right if left else right[0].upper() + right[1:]
        blocks.append(Figure("where", caption, "Where the residual is", where_figure(where)))
    return tuple(blocks)


def finding_blocks(finding: Finding) -> tuple[Block, ...]:
    """Return one finding: what it is, why not something else, how sure, what would decide."""
    rows = tuple(parameter_row(one) for one in finding.parameters)
    columns = (Column("Parameter", "left", wide=True), Column("Value"), Column("95 % interval"), Column("Unit", "left"))
    blocks: list[Block] = [Paragraph(finding.explanation)]
    if finding.family in CONCERNED:
        blocks.append(Paragraph(f"It concerns {CONCERNED[finding.family]}."))
    if finding.family == EMPIRICAL:
        blocks.append(Paragraph("No effect of the catalogue is meant: it is a law that fits, nothing more."))
    blocks.append(Table("Parameters", columns, padded(rows), _law(finding)))
    if finding.refinements:
        blocks.append(Paragraph("Of the same cause: " + "; ".join(finding.refinements) + "."))
    blocks.append(_others(finding))
    if finding.separate_by:
        blocks.append(Paragraph(f"What would decide, or confirm it: {finding.separate_by}."))
    return tuple(blocks)


def _law(finding: Finding) -> str:
    """Return the equation of a finding's effect as the catalogue states it; nothing for a law that is no physics."""
    return next(
        (f"The effect's law: {effect.equation}." for effect in catalogue() if effect.name == finding.effect), ""
    )


def parameter_row(one: FoundParameter) -> tuple[str, str, str, str]:
    """Return a parameter as printed: name, value, 95 % interval, unit; a compliance as the stiffness that it is."""
    name, value, unit = one.name.replace("_", " "), one.value, one.unit
    if one.std == 0.0:
        return name, f"{value:g}", DASH, "per revolution" if name.startswith("harmonic") else people_unit(unit)
    low, high = one.interval
    if unit not in STIFFNESS_OF or not value > 0:
        return name, _number(value), f"{_number(low)} to {_number(high)}", people_unit(unit)
    named = name.replace("compliance", "stiffness") if "compliance" in name else f"{name}, as stiffness"
    interval = f"{_number(1 / high)} to {_number(1 / low)}" if low > 0 else f"above {_number(1 / high)}"
    return named, _number(1 / value), interval, STIFFNESS_OF[unit]


def gain_blocks(found: Diagnosis) -> tuple[Block, ...]:
    """Return how much better the extended model is, on what was fitted and on what was not."""
    rows = [
        ("All readings used" if found.rms_used is None else "All readings", found.rms_before, found.rms_after),
        ("Configurations left out of the fit", found.held_out_before, found.held_out_after),
    ]
    columns = (
        Column("rms per coordinate", "left", wide=True), Column("Without findings [µm]"), Column("With findings [µm]")
    )  # fmt: skip
    rows += [(f"Blocks in {kind} left out (3-D)", b, a) for kind, (b, a) in found.blocks.items()]
    if found.test is not None:
        rows.append(("The second recording, not fitted", found.test.rms_before, found.test.rms))
        rows += [
            (f"Of it, {PARTS[part.kind]} in {counted(part.configurations, 'configuration')}", part.rms_before, part.rms)
            for part in found.test.parts
        ]
    body = [(name, significant(1e6 * b, 3), significant(1e6 * a, 3)) for name, b, a in rows]
    if found.rms_used is not None:
        body.insert(1, ("Without the readings set aside", DASH, significant(1e6 * found.rms_used, 3)))
    reason = "" if found.test is None or not found.test.reason else f" The second recording: {found.test.reason}."
    note = f"Taken for noise: {1e6 * found.noise:.1f} µm per coordinate.{reason}"
    blocks: list[Block] = [Table("Gain", columns, padded(body), note)]
    readings = found.identification.readings
    before, after = found.residual_before, found.residual
    if found.physics and before is not None and before.shape == after.shape == (len(readings), 3):
        caption = "Residual without and with the findings: a) every configuration; b) share of readings below a length."
        drawing = before_after_figure(readings, before, after, found.noise)
        blocks.append(Figure("before-after", caption, "Residual before and after", drawing))
    return tuple(blocks)


def next_blocks(found: Diagnosis, prismatic: Sequence[bool]) -> tuple[Block, ...]:
    """Return what to measure next, as a table that can be read off at the cell, with what it is good for."""
    blocks: list[Block] = []
    if found.next_text:
        blocks.append(Paragraph(found.next_text))
    if not found.next_measurements:
        return tuple(blocks) or (Paragraph("No configuration is proposed for this kind of recording."),)
    columns = (
        Column("No"),
        *joint_columns(prismatic),
        *(Column(f"F{axis} [N]") for axis in "xyz"),
    )
    rows = tuple(
        (
            str(number),
            *(fixed(float(value), 2) for value in joint_values(np.array(proposal.q), prismatic)),
            *(fixed(force, 0) for force in proposal.wrench[:3]),
        )
        for number, proposal in enumerate(found.next_measurements, start=1)
    )
    note = (
        "Force F at the full step, base axes, at the wrench point; the steps stand below. The same stands in "
        "next.yaml, which calibration simulate and the sequencer read as a plan."
    )
    blocks.append(Table("Proposed measurements", columns, padded(rows), note))
    proposals = (f"No {k}: {p.why}. {_steps_of(p)}" for k, p in enumerate(found.next_measurements, start=1))
    blocks.append(Items(tuple(proposals)))
    return tuple(blocks)


def _steps_of(proposal: ProposedMeasurement) -> str:
    """Return the load steps in words, as shares of the full force."""
    full = np.array(proposal.wrench[:3])
    power = float(full @ full)
    if power == 0.0:
        return "No load."
    shares = (100.0 * np.array(proposal.steps)[:, :3] @ full / power).round() + 0.0
    levels = [fixed(share, 0) for share in shares]
    turns = levels[1:]
    if len(turns) > 2 and turns == [turns[k % 2] for k in range(len(turns))]:
        return f"Steps: {levels[0]} % of F, then {turns[0]} % and {turns[1]} % in turn, {len(levels)} in all."
    return f"Steps: {', '.join(levels)} % of F."


def stiffness_blocks(found: Diagnosis) -> tuple[Block, ...]:
    """Return the stiffnesses without and with the findings."""
    if not found.stiffness:
        determined = [one.joint for one in found.identification.stiffness if one.identifiable]
        text = f"The findings leave the stiffness of {', '.join(determined)} as the identification states it."
        return (Paragraph(text if determined else "This recording determines no joint stiffness."),)
    return (extended_table(found.identification.stiffness, extended_joints(found)),)


def story(found: Diagnosis) -> Facts:
    """Return the whole in six lines: where, what, why not something else, how sure, how much better, what next."""
    first = found.findings[0] if found.findings else None
    where = "" if found.where is None else found.where.sentences[1 if found.where.shares else -1]
    rows = [("Where", where or "No pattern stands out of the noise.")]
    rows.append(("What", _what(found)))
    if first is not None:
        every = (other for finding in found.findings for other in finding.cannot_be_told_from)
        others = list(dict.fromkeys(effect_sentence(other.effect, other.location) for other in every))
        named = "; ".join(others[:MOST_OTHERS]) + (" and others" if others[MOST_OTHERS:] else "")
        rows.append(
            (
                "Why not something else",
                f"It may also be: {named}." if others else "No other effect explains the recording nearly as well.",
            )
        )
        sure = (
            f"{evidence_words(first.log_bayes_factor)}; on configurations left out the squared error falls by "
            f"{100 * first.held_out_gain:z.0f} %"
        )
        rows.append(("How sure", sure))
    better = (
        f"{1e6 * found.held_out_before:.1f} µm to {1e6 * found.held_out_after:.1f} µm per coordinate on configurations "
        f"left out; noise {1e6 * found.noise:.1f} µm"
    )
    rows.append(("How much better", better))
    proposal = found.next_measurements[0].why if found.next_measurements else ""
    rows.append(("What to measure next", proposal or found.next_text or "Nothing is proposed."))
    return Facts(tuple((label, text[0].upper() + text[1:]) for label, text in rows))


def _what(found: Diagnosis) -> str:
    listed = [
        f"{effect_sentence(f.effect, f.location)}{'' if f.location else ' at a place that is not decided'} "
        f"({1e6 * f.magnitude:.0f} µm rms)" + (", which is no physics" if f.family == EMPIRICAL else "")
        for f in found.findings
    ]
    if not found.physics:
        listed.insert(0, "no effect of the catalogue stands out of the noise and of many small effects")
    return "; ".join(listed) + ("" if listed[1:] or found.physics else ".")


def _others(finding: Finding) -> Block:
    if not finding.cannot_be_told_from and finding.family == EMPIRICAL:
        return Paragraph("No function at another joint describes the residual nearly as well.")
    if not finding.cannot_be_told_from:
        return Paragraph("No other effect or place of the catalogue explains the recording nearly as well.")
    rows = tuple(
        (
            effect_sentence(other.effect, other.location),
            significant(other.log_bayes_factor, 3),
            significant(finding.log_bayes_factor - other.log_bayes_factor, 2),
        )
        for other in finding.cannot_be_told_from
    )
    columns = (
        Column("Confounded with", "left", wide=True), Column("Log Bayes factor"), Column("Difference"),
    )  # fmt: skip
    return Table(
        "Explanations that do as well",
        columns,
        padded(rows),
        "Log Bayes factor within 5 of the finding's, or no difference.",
    )


def _number(value: float) -> str:
    """Return a number with three digits; small ones as a power of ten."""
    if value == 0.0 or not np.isfinite(value) or 1e-3 <= abs(value) < 1e5:
        return significant(value, 3)
    mantissa, exponent = f"{value:.2e}".split("e")
    power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa.replace('-', '−')}·10{power}"
