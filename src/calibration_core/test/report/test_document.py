"""Names from outside become printable text; tables and figures are numbered."""

from __future__ import annotations

import dataclasses

import pytest

from calibration_core.report.document import (
    Column,
    Document,
    Facts,
    Figure,
    Items,
    Section,
    Table,
    Verdict,
    cleaned,
    numbered,
    printable,
)

TABLE = Table("t", (Column("a"),), (("1",),))
FIGURE = Figure("f", "f", "f", b"<svg/>")


def document(*blocks: Table | Figure | Items) -> Document:
    return Document("n", "t", "s", Facts(()), Verdict("v", ()), blocks[:1], (Section("h", "", blocks[1:]),), (), "")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x00b", "a\ufffdb"),
        ("a\u202eb", "a\ufffdb"),
        ("a\ud800b", "a\ufffdb"),
        ("a\n\tb\u2028c", "a  b c"),
        ("<script> #set $x$ \\ * _ `", "<script> #set $x$ \\ * _ `"),
        ("Größe θ₁ \U0001f916", "Größe θ₁ \U0001f916"),
        ("20 µm, 3 kg", "20\u00a0µm, 3\u00a0kg"),
        ("4.2\u2007", "4.2\u2007"),
    ],
)
def test_printable(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_printable_cuts_what_is_too_long() -> None:
    assert len(printable("y" * 100_000)) == 1500
    assert printable("y" * 50, limit=10) == "y" * 9 + "…"


def test_cleaned_reaches_every_text_and_leaves_drawings_alone() -> None:
    dirty = document(Items(("a\x07",)), dataclasses.replace(FIGURE, caption="c\x07", svg=b"\x07"))
    clean = cleaned(dirty)
    assert clean.front == (Items(("a\ufffd",)),)
    assert clean.figures()[0].caption == "c\ufffd"
    assert clean.figures()[0].svg == b"\x07"


def test_numbers_one_and_two_stay_the_standards_own() -> None:
    second = dataclasses.replace(TABLE, number=2)
    first = dataclasses.replace(TABLE, number=1)
    result = numbered(document(second, TABLE, FIGURE, first, TABLE, FIGURE))
    assert [table.number for table in result.tables()] == [2, 3, 1, 4]
    assert [figure.number for figure in result.figures()] == [1, 2]
    further = dataclasses.replace(result, sections=(*result.sections, Section("h", "", (TABLE, FIGURE, TABLE))))
    assert [table.number for table in numbered(further).tables()] == [2, 3, 1, 4, 5, 6]
    assert [figure.number for figure in numbered(further).figures()] == [1, 2, 3]
