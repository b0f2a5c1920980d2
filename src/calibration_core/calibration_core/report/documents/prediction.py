"""The report of a prediction: an identified model beside a recording that it was, or was not, made from."""

from __future__ import annotations

import datetime as dt

import numpy as np

from calibration_core.cell import Cell
from calibration_core.outcomes.prediction import ErrorSize, Prediction
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
from calibration_core.report.rounding import (
    DASH,
    Unit,
    counted,
    fixed,
    length_unit,
    padded,
    shortened,
    spread,
)
from calibration_core.report.sections.model import model_table
from calibration_core.report.sections.procedure import MOST_ROWS, configurations, equipment, operating_space
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.sections.residuals import residual_section
from calibration_core.report.writing.rendering import document_number

STATEMENT = (
    "Nothing was fitted to the recording: every position is predicted from the encoder angles, the measured wrench and "
    "the identified model alone. If the model was identified from the same recording, the errors are no test of it."
)


def prediction_document(
    found: Prediction, cell: Cell, result: bytes, light: Light, day: dt.date | None = None
) -> Document:
    """Build the report of a prediction.

    Args:
        found: Recording and prediction.
        cell: The cell.
        result: The bytes of result.json, for the report's number.
        light: Whether the prediction can be used, as result.json says.
        day: Date of evaluation; today (UTC) if not given.
    """
    day = day or dt.datetime.now(dt.UTC).date()
    space = found.space
    sections = (
        Section("Residuals", "", residual_section(found.shown())),
        Section("Identified model", "8 f)", _model(found, cell)),
        Section("Measuring equipment", "8 e)", equipment(cell)),
        Section("Operating space", "8 g)", operating_space(space)),
        Section(
            "Encoder angles", "8 d)", configurations(space.configuration, space.q, cell.prismatic, _encoder_note(found))
        ),
        Section("Remarks on the recording", "", _remarks(found)),
        Section("Input and software", "", traceability_section(cell, found.readings.provenance, found.inputs)),
    )
    document = Document(
        number=document_number(result),
        title="Prediction by an identified model",
        subtitle="Elastostatic compliance calibration according to CWA 17384",
        facts=_facts(found, cell, day),
        verdict=_verdict(found, light),
        front=_errors(found),
        sections=sections,
        signatures=("Evaluated by", "Approved by"),
        statement=STATEMENT,
    )
    return numbered(cleaned(document))


def _facts(found: Prediction, cell: Cell, day: dt.date) -> Facts:
    readings = found.readings
    provenance = readings.provenance
    steps = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    rows = (
        ("Industrial robot", cell.robot.name),
        ("Cell", cell.name),
        ("Date of the test", date_of_test(provenance.start)),
        ("Date of evaluation", f"{day:%Y-%m-%d}"),
        ("Recording", f"{provenance.path} ({provenance.kind})"),
        (
            "Extent",
            (
                f"{counted(len(found.space.q), 'configuration')}, {counted(len(steps), 'step')}, "
                f"{counted(len(readings.points), 'measurement point')}, {counted(len(readings), 'reading')}"
            ),
        ),
        (
            "Identified model",
            ", ".join(f"{name} (SHA-256 {digest[:12]}…)" for name, digest in found.inputs["model"].items()),
        ),
    )
    return Facts(rows)


def _verdict(found: Prediction, light: Light) -> Verdict:
    unit = length_unit(found.error.maximum)
    what = "Positions" if found.kind == "absolute" else "Deflections"
    mean, largest = (_size(value, unit) for value in (found.error.mean, found.error.maximum))
    headline = f"{what} predicted to {mean} on average, {largest} at worst"
    expected = float(np.sqrt(np.mean(found.residuals.sigma**2)))
    lines = [*light.rows, ("Result", headline)]
    if found.before is not None:
        before = length_unit(found.before.mean)
        lines.append(
            ("Cell file", f"the cell file's model predicts them to {_size(found.before.mean, before)} on average")
        )
    if found.deflection is not None and found.kind == "absolute":
        after, nominal = found.deflection
        size, other = length_unit(after.mean), length_unit(nominal.mean)
        lines.append(
            (
                "Deflections",
                (
                    f"differences to step 0: {_size(after.mean, size)} on average, {_size(after.maximum, size)} "
                    f"at worst (cell file: {_size(nominal.mean, other)} on average)"
                ),
            )
        )
    lines.append(
        (
            "Residual",
            (
                f"{_size(found.error.rms, unit)} rms per coordinate, against {_size(expected, length_unit(expected))} "
                "stated for one reading of the tracker"
            ),
        )
    )
    lines.append(("Fitted", "nothing; frames, points, geometry and compliances are the model's"))
    return Verdict(light.headline, tuple((label, text[0].upper() + text[1:]) for label, text in lines), light.usable)


def _errors(found: Prediction) -> tuple[Block, ...]:
    unit = length_unit(found.error.rms)
    cases: list[tuple[str, ErrorSize | None]] = [
        ("positions, cell file" if found.kind == "absolute" else "deflections, cell file", found.before),
        ("positions, identified model" if found.kind == "absolute" else "deflections, identified model", found.error),
    ]
    if found.deflection is not None and found.kind == "absolute":
        cases += [
            ("differences to step 0, cell file", found.deflection[1]),
            ("differences to step 0, identified model", found.deflection[0]),
        ]
    rows = [
        (label, DASH, DASH, DASH)
        if error is None
        else (label, *(spread(value * unit.factor) for value in (error.rms, error.mean, error.maximum)))
        for label, error in cases
    ]
    columns = (
        Column("Prediction of", "left", wide=True),
        Column(f"rms per coordinate [{unit.name}]"),
        Column(f"Mean, 3-D [{unit.name}]"),
        Column(f"Largest, 3-D [{unit.name}]"),
    )
    note = "A dash: the cell file states no tracker pose." if found.before is None else ""
    return (Table("Errors of prediction", columns, padded(rows), note),)


def _model(found: Prediction, cell: Cell) -> tuple[Block, ...]:
    parameters = found.parameters
    points = tuple(
        (f"Point {shortened(name)}", f"({', '.join(fixed(1e3 * float(x), 3) for x in point)}) mm, flange frame")
        for name, point in parameters.points.items()
    )
    origin = ", ".join(fixed(1e3 * float(x), 3) for x in parameters.tracker[:3, 3])
    return (
        model_table(parameters, cell, "Joints of the identified model"),
        Facts((("Tracker", f"origin at ({origin}) mm, base frame"), *points)),
    )


def _encoder_note(found: Prediction) -> str:
    return "Encoder angles at the largest load." if found.space.force is not None else ""


def _remarks(found: Prediction) -> tuple[Block, ...]:
    notes = found.readings.notes
    if not notes:
        return (Paragraph("Nothing was noticed."),)
    texts = [f"{note.kind.replace('_', ' ')}, {note.place}: {note.text}" for note in notes[:MOST_ROWS]]
    if len(notes) > MOST_ROWS:
        texts.append(f"{len(notes) - MOST_ROWS:,} further remarks stand in result.json.")
    return (Items(tuple(texts)),)


def _size(value: float, unit: Unit) -> str:
    return f"{spread(value * unit.factor)} {unit.name}"
