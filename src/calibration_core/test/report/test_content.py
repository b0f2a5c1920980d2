"""The report says what clause 8 of CWA 17384 asks for, with the numbers of the answer."""

from __future__ import annotations

import dataclasses
import datetime as dt

import numpy as np
import pytest

from calibration_core.cell import Cell, Safety
from calibration_core.identification.result.estimate import Identification, NoiseCheck
from calibration_core.identification.stiffness.predict import references
from calibration_core.report.content import build, date_of_test
from calibration_core.report.document import Document, Facts, Items, Paragraph, Table
from calibration_core.report.sections import procedure, records, residuals, stiffness, uncertainty
from calibration_core.report.shown import shown

DAY = dt.date(2026, 3, 5)
Case = tuple[Identification, Cell]


@pytest.fixture(autouse=True)
def no_drawings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Words and numbers are tested here; the drawings have their own tests and take most of the time."""
    names = (
        "space_figure",
        "residual_figure",
        "prediction_figure",
        "normality_figure",
        "correlation_figure",
        "stiffness_figure",
    )
    for module in (procedure, residuals, stiffness, uncertainty):
        for name in names:
            if hasattr(module, name):
                monkeypatch.setattr(module, name, lambda *_: b"<svg/>")


def table(document: Document, number: int) -> Table:
    return next(item for item in document.tables() if item.number == number)


def titled(document: Document, caption: str) -> Table:
    return next(item for item in document.tables() if item.caption.startswith(caption))


def text(document: Document) -> str:
    parts = [document.statement, document.verdict.headline, *(" ".join(line) for line in document.verdict.lines)]
    for block in document.blocks():
        if isinstance(block, Paragraph):
            parts.append(block.text)
        elif isinstance(block, Items):
            parts += block.texts
        elif isinstance(block, Facts):
            parts += [" ".join(row) for row in block.rows]
        elif isinstance(block, Table):
            parts += [block.caption, block.note, *(cell for row in block.rows for cell in row)]
        else:
            parts.append(block.caption)
    return "\n".join(parts).replace("\u00a0", " ")


def test_everything_clause_8_asks_for_is_there(loaded: Identification, cell: Cell) -> None:
    document = build(loaded, cell, DAY)
    facts = dict(document.facts.rows)
    assert "CWA 17384" in document.subtitle
    assert facts["Date of the test"] == "2026-03-02 09:14 UTC"
    assert facts["Date of evaluation"] == "2026-03-05"
    assert facts["Industrial robot"] == "KR 240 class"
    assert {"8 d)", "8 e)", "8 f)", "8 g)"} <= {section.clause for section in document.sections}
    place = {section.clause: i + 1 for i, section in enumerate(document.sections)}
    assert f"g) operating space in section {place['8 g)']}" in text(document)
    assert [figure.key for figure in document.figures() if figure.turnable] == ["space"]


def test_a_declared_speed_limit_is_reported(loaded: Identification, cell: Cell) -> None:
    assert "manual reduced speed only" in text(build(loaded, cell, DAY))
    declaring = cell.model_copy(update={"safety": Safety(speed_limit=0.2, source="checksum 8A3F")})
    said = text(build(loaded, declaring, DAY))
    assert "200 mm/s, by the controller in every mode; declared by: checksum 8A3F" in said
    assert "manual reduced speed only" not in said


def test_table_1_has_the_templates_form(loaded: Identification, cell: Cell) -> None:
    first = table(build(loaded, cell, DAY), 1)
    assert [column.head for column in first.columns] == ["No", *(f"θ{c} [°]" for c in "₁₂₃₄₅₆")]
    shown = np.array([[float(angle.replace("−", "-")) for angle in row[1:]] for row in first.rows])
    np.testing.assert_allclose(shown, np.degrees(loaded.space.q), atol=5.1e-4)
    assert first.note == ""


def test_table_2_is_rounded_by_its_uncertainty(loaded: Identification, cell: Cell) -> None:
    second = table(build(loaded, cell, DAY), 2)
    assert second.columns[2].head == "Stiffness [10⁵ N·m/rad]"
    rows = [tuple(entry.strip("\u2007") for entry in row) for row in second.rows]
    assert rows[0] == ("kθ₁", "joint_1", "14.10", "13.88 to 14.32", "0.11", "0.80", "15.51", "yes")
    assert rows[5] == ("kθ₆", "joint_6", "2.100", "1.980 to 2.236", "0.065", "3.1", "2.310", "yes")


def test_verdict_box_of_a_good_test(loaded: Identification, cell: Cell) -> None:
    verdict = build(loaded, cell, DAY).verdict
    lines = {label: line.replace("\u00a0", " ") for label, line in verdict.lines}
    assert verdict.headline == "Usable with reservations"
    assert lines["Why"].startswith("Outlier readings: ")
    assert lines["Result"] == "Joint stiffness identified: 6 of 6 joints"
    assert lines["Uncertainty"] == "Largest relative standard uncertainty 3.1 % (joint_6)"
    assert lines["Requirements"].startswith("4 of 6 met, 1 not met, 1 not visible in the recording; not met: load at")
    assert lines["Readings"] == "483 of 486 used, 3 set aside and named"
    assert "this agrees with" in lines["Residual"]


def test_a_rest_is_said_on_the_first_page(loaded: Identification, cell: Cell) -> None:
    noise = dataclasses.replace(loaded.noise, checks=(NoiseCheck("residual", 9e-5, 1272),))
    verdict = build(dataclasses.replace(loaded, noise=noise), cell, DAY).verdict
    assert verdict.headline == "Usable with reservations"
    assert "the residual is more than noise" in dict(verdict.lines)["Why"]
    assert dict(verdict.lines)["Result"].endswith("the residual is more than noise")
    assert "exceeds" in dict(verdict.lines)["Residual"]


def test_a_joint_that_is_not_determined_is_named_with_its_reason(loaded: Identification, cell: Cell) -> None:
    weak = dataclasses.replace(
        loaded.stiffness[5],
        value=np.inf,
        std=np.inf,
        interval=(9e4, np.inf),
        identifiable=False,
        reason="no torque acts",
    )
    document = build(dataclasses.replace(loaded, stiffness=(*loaded.stiffness[:5], weak)), cell, DAY)
    assert document.verdict.headline == "Usable with reservations"
    assert "not identifiable: joint_6" in dict(document.verdict.lines)["Why"]
    assert dict(document.verdict.lines)["Result"] == "Joint stiffness identified: 5 of 6 joints"
    assert dict(document.verdict.lines)["Not identifiable"] == "joint_6"
    assert table(document, 2).rows[5][2:4] == ("–", "≥ 0.90")
    assert "kθ₆ (joint_6): no torque acts" in text(document)


def test_no_change_is_stated_of_a_stiffness_that_is_not_determined(loaded: Identification) -> None:
    first = loaded.stiffness[0]
    weak = dataclasses.replace(loaded.stiffness[5], value=7e7, std=6.4e8, interval=(2.84e6, 1.9e8), identifiable=False)
    softer = dataclasses.replace(first, value=0.7 * first.value)
    after = (softer, *loaded.stiffness[1:5], weak)
    found = stiffness.extended_table(loaded.stiffness, after)
    assert found.rows[0][-1] == "−30"
    assert found.rows[1][-1] == "0"
    assert found.rows[5][3] == "28 to 1900"
    assert found.rows[5][-1] == "–"
    assert found.note == stiffness.NO_CHANGE
    assert stiffness.extended_table(loaded.stiffness[:1], after[:1]).note == ""


def test_diamonds_are_explained_where_there_are_any(loaded: Identification, cell: Cell, absolute_cell: Cell) -> None:
    assert "diamonds: cell file" in stiffness.drawing_of(loaded, cell).caption
    assert "diamonds" not in stiffness.drawing_of(loaded, absolute_cell).caption


def test_outliers_are_no_stretch_of_configurations(loaded: Identification) -> None:
    (named,) = (one for one in loaded.anomalies if one.kind == "outlier_readings")
    named = dataclasses.replace(named, configurations=(11, 17))
    (remarks,) = records.remark_section(dataclasses.replace(loaded, anomalies=(named,)))
    assert isinstance(remarks, Items)
    assert f"outlier readings: {named.text}" in remarks.texts


def test_an_absolute_recording_says_why_table_2_is_empty(absolute: Identification, absolute_cell: Cell) -> None:
    document = build(absolute, absolute_cell, DAY)
    assert 2 not in [item.number for item in document.tables()]
    assert "Table 2 of the standard stays empty" in text(document)
    assert "Elasticity was examined and not kept: held-out rms does not fall" in text(document)
    stages = titled(document, "Stages")
    assert [row[0] for row in stages.rows] == ["nominal", "frames", "geometry", "elasticity"]
    assert dict(document.facts.rows)["Date of the test"] == "not stated in the recording"
    assert len(table(document, 1).rows) == 40
    assert table(document, 1).note == "First 40 of 216; all of them stand in table1.csv."


def test_equipment_that_is_not_named_is_said_to_be_so(absolute: Identification, absolute_cell: Cell) -> None:
    rows = titled(build(absolute, absolute_cell, DAY), "Measuring equipment").rows
    assert [entry.replace("\u00a0", " ") for entry in rows[0]] == [
        "Laser tracker", "not stated", "not stated", "not stated", "20 µm per coordinate",
    ]  # fmt: skip
    assert rows[1][4] == "not stated"


def test_spherical_tracker_uncertainty(loaded: Identification, cell: Cell) -> None:
    tracker = cell.instruments.tracker.model_copy(
        update={"sigma": None, "sigma_range": 5e-6, "sigma_range_per_m": 1e-6, "sigma_angle": 3e-6}
    )
    instruments = cell.instruments.model_copy(update={"tracker": tracker})
    rows = titled(build(loaded, cell.model_copy(update={"instruments": instruments}), DAY), "Measuring equipment").rows
    assert rows[0][4].replace("\u00a0", " ") == "range 5.0 µm + 1.0 µm/m, angles 3.0 µrad"


def test_exclusions_are_named_and_can_be_readmitted(loaded: Identification, cell: Cell) -> None:
    document = build(loaded, cell, DAY)
    assert len(titled(document, "Readings not used").rows) == 3
    assert "--readmit CONFIGURATION:STEP:POINT" in text(document)


def test_reference_steps_of_displacements_are_not_shown(loaded: Identification, cell: Cell) -> None:
    displaced = cell.model_copy(
        update={"measurements": cell.measurements.model_copy(update={"points": "displacement"})}
    )
    excluded = np.zeros(len(loaded.readings), dtype=bool)
    answer = dataclasses.replace(loaded, residuals=dataclasses.replace(loaded.residuals, excluded=excluded))
    per_point = titled(build(answer, displaced, DAY), "Residuals per measurement point").rows
    assert [row[1] for row in per_point] == ["144", "144", "144"]
    view = shown(answer, displaced)
    assert np.all(view.readings.step > 0)
    np.testing.assert_array_equal(references(loaded.readings), loaded.readings.step == 0)


def test_expected_deviation_counts_what_the_fit_took_up(loaded: Identification, cell: Cell) -> None:
    used = 3 * (len(loaded.readings) - 3)
    fit = dataclasses.replace(loaded.fit, degrees_of_freedom=used - 168)
    view = shown(dataclasses.replace(loaded, fit=fit), cell)
    np.testing.assert_allclose(view.residuals.sigma, loaded.residuals.sigma * np.sqrt(1 - 168 / used))
    assert len(view.readings) == len(loaded.readings)


def test_combinations_are_written_with_signs(absolute: Identification, absolute_cell: Cell) -> None:
    words = text(build(absolute, absolute_cell, DAY))
    assert "both move the point along the same axis (1.00 d_1 − 1.00 tracker z)" in words


def test_nothing_to_report_is_said(loaded: Identification, cell: Cell) -> None:
    quiet = dataclasses.replace(loaded, exclusions=(), anomalies=(), notes=(), test=None)
    words = text(build(quiet, cell, DAY))
    assert "Every reading was used." in words
    assert "Nothing was noticed." in words


def test_files_stand_with_their_digests(loaded: Identification, cell: Cell) -> None:
    rows = titled(build(loaded, cell, DAY), "Input files").rows
    assert ("recording", "demo_0.mcap", "a" * 64) in rows
    assert ("cell", "cells/demo.cell.yaml", "c" * 64) in rows


def test_correlations_of_many_parameters_are_the_strongest_pairs(absolute: Identification, absolute_cell: Cell) -> None:
    strongest = titled(build(absolute, absolute_cell, DAY), "Strongest correlations").rows[0]
    assert strongest == ("tracker x", "target x", "0.970")


def test_number_belongs_to_the_answer(loaded: Identification, cell: Cell) -> None:
    changed = dataclasses.replace(loaded, condition_number=8.43)
    assert build(loaded, cell, DAY).number == build(loaded, cell, DAY).number
    assert build(loaded, cell, DAY).number != build(changed, cell, DAY).number


@pytest.mark.parametrize(
    ("start", "shown"),
    [
        ("", "not stated in the recording"),
        ("2026-03-02", "2026-03-02"),
        ("2026-03-02T09:14:05Z", "2026-03-02 09:14 UTC"),
        ("yesterday", "yesterday"),
    ],
)
def test_date_of_the_test(start: str, shown: str) -> None:
    assert date_of_test(start) == shown


def test_hostile_names_stay_text(hostile: Case) -> None:
    document = build(*hostile, DAY)
    assert "<script>alert(1)</script> #set page(width: 1cm) $x^2$" in text(document)
    assert not any(ord(c) < 32 and c != "\n" for c in text(document))
