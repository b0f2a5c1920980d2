"""The report as a value: sections of paragraphs, facts, tables and figures, from which HTML and PDF are both made.

Everything is plain text, never markup: the renderers escape or quote it, so that a name from outside stays a name.
"""

from __future__ import annotations

import dataclasses
import re
import unicodedata
from typing import Literal, TypeVar

Align = Literal["left", "right", "center"]
Value = TypeVar("Value")

MAX_TEXT = 1500

_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:[µmk]?m|mm/s|[km]?N|N·m|kg|%|°C|K|m?rad|µrad|µm/m|times|σ)(?![\w]))")


@dataclasses.dataclass(frozen=True)
class Column:
    """Head of a table's column.

    Attributes:
        head: Text, with the unit in square brackets where there is one.
        align: How the cells stand.
        wide: Whether the column holds running text and takes the space that is left.
    """

    head: str
    align: Align = "right"
    wide: bool = False


@dataclasses.dataclass(frozen=True)
class Table:
    """A table with its caption.

    Attributes:
        caption: What it shows, without the number.
        columns: Heads.
        rows: Cells as printed.
        note: Small print below it.
        number: Number in the report; 0 is given by `numbered`, 1 and 2 are the standard's own.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    number: int = 0
    kind: Literal["table"] = "table"


@dataclasses.dataclass(frozen=True)
class Facts:
    """Labels with their values, one line each."""

    rows: tuple[tuple[str, str], ...]
    kind: Literal["facts"] = "facts"


@dataclasses.dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str
    kind: Literal["paragraph"] = "paragraph"


@dataclasses.dataclass(frozen=True)
class Items:
    """A list of remarks."""

    texts: tuple[str, ...]
    kind: Literal["items"] = "items"


@dataclasses.dataclass(frozen=True)
class Figure:
    """A drawing.

    Attributes:
        key: Short stable name.
        caption: What it shows, without the number.
        alt: The same for those who cannot see it.
        turnable: Whether the HTML shows the 3-D scene in its place.
        number: Number in the report, given by `numbered`.
    """

    key: str
    caption: str
    alt: str
    svg: bytes
    turnable: bool = False
    number: int = 0
    kind: Literal["figure"] = "figure"


Block = Table | Facts | Paragraph | Items | Figure


@dataclasses.dataclass(frozen=True)
class Section:
    """A numbered section.

    Attributes:
        heading: Its title.
        clause: What of the standard it answers, e.g. `8 d)`; empty if nothing.
    """

    heading: str
    clause: str
    blocks: tuple[Block, ...]


@dataclasses.dataclass(frozen=True)
class Verdict:
    """The box on the first page.

    Attributes:
        headline: The result in one line.
        lines: What a reader must know to judge it: label and statement.
        light: `yes`, `with_reservations` or `no`, as in result.json; empty where nothing is judged.
    """

    headline: str
    lines: tuple[tuple[str, str], ...]
    light: str = ""


@dataclasses.dataclass(frozen=True)
class Document:
    """The whole report.

    Attributes:
        number: Report number.
        subtitle: The standard it answers to.
        facts: Identification of robot, recording and dates.
        verdict: The box on the first page.
        front: Blocks of the first page.
        sections: The rest.
        signatures: Roles that sign.
        statement: Small print of the first page.
    """

    number: str
    title: str
    subtitle: str
    facts: Facts
    verdict: Verdict
    front: tuple[Block, ...]
    sections: tuple[Section, ...]
    signatures: tuple[str, ...]
    statement: str

    @property
    def robot(self) -> str:
        """Return the robot's name; empty where the facts name none."""
        return dict(self.facts.rows).get("Industrial robot", "")

    def tables(self) -> tuple[Table, ...]:
        """Return every table, in the order of the report."""
        return tuple(block for block in self.blocks() if isinstance(block, Table))

    def figures(self) -> tuple[Figure, ...]:
        """Return every figure, in the order of the report."""
        return tuple(block for block in self.blocks() if isinstance(block, Figure))

    def blocks(self) -> tuple[Block, ...]:
        """Return every block, in the order of the report."""
        return self.front + tuple(block for section in self.sections for block in section.blocks)


def numbered(document: Document) -> Document:
    """Number figures from 1 and tables from 3 on (tables 1 and 2 are the standard's own and keep their numbers).

    Tables that have numbers keep them, and others go on after these.
    """
    tables, figures = max((2, *(table.number for table in document.tables()))), 0

    def number(block: Block) -> Block:
        nonlocal tables, figures
        if isinstance(block, Table) and not block.number:
            tables += 1
            return dataclasses.replace(block, number=tables)
        if isinstance(block, Figure):
            figures += 1
            return dataclasses.replace(block, number=figures)
        return block

    front = tuple(number(block) for block in document.front)
    sections = tuple(
        dataclasses.replace(section, blocks=tuple(number(block) for block in section.blocks))
        for section in document.sections
    )
    return dataclasses.replace(document, front=front, sections=sections)


def cleaned(value: Value) -> Value:
    """Return the same value with `printable` applied to every text in it."""
    if isinstance(value, str):
        return printable(value)  # type: ignore[return-value]
    if isinstance(value, tuple):
        return tuple(cleaned(item) for item in value)  # type: ignore[return-value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changes = {field.name: cleaned(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **changes)
    return value


def printable(text: str, limit: int = MAX_TEXT) -> str:
    """Return a text that can be printed: one line, at most `limit` long, units not parted from numbers.

    Control, format, private and surrogate characters become the replacement character.
    """
    kept = "".join(
        "\ufffd" if unicodedata.category(c) in {"Cc", "Cf", "Cs", "Co", "Cn"} and not c.isspace() else c
        for c in text[: 4 * limit]
    )
    line = kept.translate({ord(c): " " for c in "\t\n\r\x0b\x0c\x1c\x1d\x1e\x1f\x85\u2028\u2029"}).strip(" ")
    return _BEFORE_UNIT.sub("\u00a0", line if len(line) <= limit else line[: limit - 1] + "…")
