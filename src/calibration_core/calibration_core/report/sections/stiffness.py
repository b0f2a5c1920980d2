"""Table 2, what cannot be identified, and how well the model fits (CWA 17384, clause 8)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification, JointStiffness
from calibration_core.identification.result.tested import PARTS, TestResult
from calibration_core.report.document import Block, Column, Figure, Items, Paragraph, Table
from calibration_core.report.figures.identification import stiffness_figure
from calibration_core.report.results.verdict import ResidualVerdict
from calibration_core.report.rounding import (
    DASH,
    STIFFNESS,
    Unit,
    aligned,
    counted,
    decimals,
    fixed,
    interval_end,
    length_unit,
    padded,
    phrase,
    shortened,
    spread,
    subscript,
)


def symbol(index: int) -> str:
    """Return the standard's symbol of a joint's stiffness, joints counted from 1."""
    return "kθ" + subscript(index)


def table_2(result: Identification, cell: Cell) -> Table:
    """Return Table 2 of the standard with intervals, standard uncertainties and what the cell file states."""
    nominal = cell.robot.stiffness
    cells = [_cells(joint) for joint in result.stiffness]
    value, std, relative = (aligned(column) for column in zip(*[c[:3] for c in cells], strict=True))
    rows = []
    for i, joint in enumerate(result.stiffness):
        stated = fixed(nominal[i] * STIFFNESS.factor, _places(joint)) if nominal else DASH
        rows.append(
            (
                symbol(i + 1),
                shortened(joint.joint) if joint.unit == "N*m/rad" else f"{shortened(joint.joint)} [10⁵ N/m]",
                value[i],
                cells[i][3],
                std[i],
                relative[i],
                stated,
                "yes" if joint.identifiable else "no",
            )
        )
    stated_column = aligned([row[6] for row in rows])
    body: list[tuple[str, ...]] = [
        (*row[:6], cell_file, row[7]) for row, cell_file in zip(rows, stated_column, strict=True)
    ]
    columns: tuple[Column, ...] = (
        Column("Joint", "left"),
        Column("Name", "left", wide=True),
        Column(f"Stiffness [{STIFFNESS.name}]"),
        Column("95 % interval", "center"),
        Column("Standard uncertainty"),
        Column("Relative [%]"),
        Column("Cell file"),
        Column("Identifiable", "center"),
    )
    note = (
        f"All in {STIFFNESS.name}. Values are rounded to two significant digits of their standard uncertainty "
        "(one standard "
        "deviation). “Cell file” is the value that the simulation uses today."
    )
    beside = any(joint.extended is not None for joint in result.stiffness)
    if beside:
        note += (
            " Interval and standard uncertainty include the bias of what the standard's model leaves out. “Extended "
            "model” is the 95 % interval of the stiffness with that in the model."
        )
        place = columns.index(Column("Relative [%]"))  # gives its room to the extended model
        columns = (*columns[:place], Column("Extended model", "center"), *columns[place + 1 :])
        body = [
            (*row[:place], _beside(joint), *row[place + 1 :]) for row, joint in zip(body, result.stiffness, strict=True)
        ]
    return Table("Test results: joint stiffness", columns, tuple(body), note, number=2)


def left_out(result: Identification, findings: Sequence[str], *, unexplained: bool = False) -> tuple[Block, ...]:
    """Return the sentences that say why the intervals of Table 2 are wider than noise makes them."""
    texts = []
    if any(joint.extended is not None for joint in result.stiffness):
        texts.append(
            "The standard's model, joint springs alone, does not hold for this recording. It leaves something out "
            f"({phrase(findings)}), and the joint springs take up a part of it. Table 2 stands as the standard asks "
            "for, with intervals that include this bias; the stiffness to use is that of the extended model."
        )
    if unexplained:
        texts.append(
            "The residual is more than noise, and nothing in the catalogue explains "
            f"{'the rest of it' if findings else 'it'}: the model does not hold for this recording. The intervals of "
            "Table 2 include what whole configurations scatter, but no bias of a cause that nobody knows: do not rely "
            "on them before the cause is found."
        )
    return tuple(Paragraph(text) for text in texts)


def extended_table(standard: Sequence[JointStiffness], extended: Sequence[JointStiffness]) -> Table:
    """Return the stiffnesses of the extended model beside those of the standard's, in Table 2's unit and rounding."""
    rows = []
    for before, after in zip(standard, extended, strict=True):
        value, std, relative, interval = _cells(after)
        change = 100 * (after.value / before.value - 1)
        rows.append(
            (
                shortened(after.joint) if after.unit == "N*m/rad" else f"{shortened(after.joint)} [10⁵ N/m]",
                _cells(before)[0],
                value,
                interval,
                std,
                relative,
                _signed(change) if before.identifiable and after.identifiable else DASH,
            )
        )
    columns = (
        Column("Joint", "left", wide=True),
        Column(f"Without findings [{STIFFNESS.name}]"),
        Column("With findings"),
        Column("95 % interval", "center"),
        Column("Standard uncertainty"),
        Column("Relative [%]"),
        Column("Change [%]"),
    )
    note = "" if all(joint.identifiable for joint in (*standard, *extended)) else NO_CHANGE
    return Table("Joint stiffness", columns, padded(rows), note)


NO_CHANGE = "No change is stated where the recording does not determine the stiffness with and without the findings."


def _signed(percent: float) -> str:
    """Return a change in whole percent with its sign."""
    return ("+" if round(percent) > 0 else "") + fixed(percent, 0)


def _beside(joint: JointStiffness) -> str:
    return DASH if joint.extended is None else _cells(joint.extended)[3]


def limits(result: Identification) -> tuple[Block, ...]:
    """Return what this recording cannot determine, joint by joint and combination by combination."""
    texts = [
        f"{symbol(i + 1)} ({shortened(joint.joint)}): {joint.reason}"
        for i, joint in enumerate(result.stiffness)
        if joint.reason
    ]
    for item in result.unidentified:
        terms = " ".join(
            f"{'−' if weight < 0 else '+'} {abs(weight):.2f} {name}" for name, weight in item.combination.items()
        )
        single = len(item.combination) == 1
        texts.append(
            f"{next(iter(item.combination))}: {item.reason}"
            if single
            else f"{item.reason} ({terms.removeprefix('+ ')})"
        )
    if not texts:
        return (Paragraph("Every parameter asked for is determined by this recording."),)
    return (Paragraph("This recording limits or does not determine:"), Items(tuple(texts)))


def drawing_of(result: Identification, cell: Cell) -> Figure:
    """Return the drawing of the stiffnesses with their intervals and what the cell file states."""
    return Figure(
        "stiffness",
        "a) Joint stiffness, logarithmic; b) its 95 % interval relative to the value. Dots: identified, hollow "
        f"where this recording does not determine the joint{'; diamonds: cell file' if cell.robot.stiffness else ''}.",
        "Dot plot of the stiffness of every joint with 95 percent intervals",
        stiffness_figure(result.stiffness, cell.robot.stiffness),
    )


def fit_section(result: Identification, cell: Cell, rest: ResidualVerdict) -> tuple[Block, ...]:
    """Return how well the model explains the recording, on fitted and on held-out configurations."""
    fit = result.fit
    unit = length_unit(fit.rms_after)
    before = "cell file, frames refitted" if result.kind == "absolute" or cell.robot.stiffness else "rigid robot"
    if result.given is not None:
        before = "given model, frames refitted"
    used: tuple[tuple[str, str, str], ...] = ()
    if math.isfinite(fit.rms_used) and np.any(result.residuals.excluded):
        used = (("after, without the readings set aside", _length(fit.rms_used, unit), DASH),)
    rows = (
        (f"before ({before})", _length(fit.rms_before, unit), _length(fit.held_out_rms_before, unit)),
        ("after (identified)", _length(fit.rms_after, unit), _length(fit.held_out_rms_after, unit)),
        *used,
        ("expected from the instruments", _length(fit.noise, unit), DASH),
    )
    columns = (
        Column("Model", "left", wide=True),
        Column(f"rms residual [{unit.name}]"),
        Column(f"rms, configuration left out [{unit.name}]"),
    )
    blocks: list[Block] = [
        Table(
            "Residuals before and after the identification, per coordinate",
            columns,
            padded(rows),
            "“Left out”: every configuration is predicted from a fit to all others.",
        ),
        Paragraph(
            "Prediction error of configurations left out (3-D): mean "
            f"{_length(fit.held_out_mean_after, unit)} {unit.name}, "
            f"largest {_length(fit.held_out_max_after, unit)} {unit.name}. {rest_text(rest)}"
        ),
    ]
    if result.test is not None:
        blocks += _test_blocks(result.test, unit, "cell file" if result.given is None else "given model")
    return tuple(blocks)


def _test_blocks(test: TestResult, unit: Unit, before: str) -> tuple[Block, ...]:
    rows: tuple[tuple[str, ...], ...] = (
        (f"before ({before})", _length(test.rms_before, unit), _length(test.mean_before, unit), DASH),
        ("after (identified)", _length(test.rms, unit), _length(test.mean, unit), _length(test.maximum, unit)),
    )
    for part in test.parts:
        kind = PARTS[part.kind]
        sizes = (_length(size, unit) for size in (part.rms, part.mean, part.maximum))
        rows += (
            (f"{kind}, before", _length(part.rms_before, unit), _length(part.mean_before, unit), DASH),
            (f"{kind}, after", *sizes),
        )
    columns = (
        Column("Model", "left", wide=True),
        Column(f"rms per coordinate [{unit.name}]"),
        Column(f"Mean, 3-D [{unit.name}]"),
        Column(f"Largest, 3-D [{unit.name}]"),
    )
    note = f"{test.file}, {counted(test.readings, 'reading')}; it took no part in the fit."
    note += f" {test.reason[0].upper()}{test.reason[1:]}." if test.reason else ""
    return (Table("Test of the identified model on a second recording", columns, padded(rows), note),)


def rest_text(rest: ResidualVerdict) -> str:
    """Return in words whether the residuals are noise."""
    unit = length_unit(rest.seen)
    source = (
        "the instruments' stated noise"
        if rest.source == "instruments"
        else f"the noise seen without the model ({rest.source})"
    )
    seen, noise, excess = (f"{spread(size * unit.factor)} {unit.name}" for size in (rest.seen, rest.noise, rest.rms))
    shows = f"The residuals show a standard deviation of {seen} per coordinate of one reading;"
    if not rest.significant:
        return f"{shows} this agrees with {source}, {noise}."
    numbers = ", ".join(str(number) for number in rest.configurations)
    return (
        f"{shows} beyond chance this exceeds {source}, {noise}. {excess} are explained neither by the identified model "
        f"nor by that noise; the residual is largest along {rest.axis} and in configurations {numbers}."
    )


def _cells(joint: JointStiffness) -> tuple[str, str, str, str]:
    places, scale = _places(joint), STIFFNESS.factor
    low, high = (interval_end(one * scale, places) for one in joint.interval)
    interval = (
        f"{low} to {high}" if math.isfinite(joint.interval[1]) else (f"≥ {low}" if joint.interval[0] > 0 else DASH)
    )
    relative = 100 * joint.std / joint.value if math.isfinite(joint.value) and joint.value > 0 else math.nan
    return fixed(joint.value * scale, places), fixed(joint.std * scale, places), spread(relative), interval


def _places(joint: JointStiffness) -> int:
    if math.isfinite(joint.std) and joint.std > 0:
        return decimals(joint.std * STIFFNESS.factor)
    return decimals(joint.interval[0] * STIFFNESS.factor, 2)


def _length(value: float, unit: Unit) -> str:
    return spread(value * unit.factor)
