"""Rows and columns of a text table: separator, decimal mark, header and units row are found, not asked for."""

from __future__ import annotations

import csv
import dataclasses
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.foreign.text import Text
from calibration_core.recording.foreign.units import unit_of

SEPARATORS = ("\t", ";", "|", ",")  # blanks are tried last, because names contain them
BLANKS = " "
LEAST_NUMBERS = 3  # in a row of data: the coordinates of a point
COMMENT = re.compile(r"^\s*(?:#|//|!|%|\*|;(?=\s*[A-Za-z]))+\s*")
_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(?:\d+,?\d*|,\d+)(?:[eE][+-]?\d+)?"),
}
_GROUPED = {".": re.compile(r"[+-]?\d{1,3}(?:,\d{3})+\.\d+"), ",": re.compile(r"[+-]?\d{1,3}(?:\.\d{3})+,\d+")}
_COULD_BE_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:,\d{3})+")


@dataclasses.dataclass(frozen=True)
class Grid:
    """A table as text.

    Attributes:
        path: The file.
        header: Names of the columns; empty if the file has none.
        units: Row of units below the header; empty if there is none.
        rows: Fields of the rows of data, all as long as the first.
        lines: Line number of each row.
        separator: Between fields; a blank stands for any run of blanks.
        decimal: Decimal mark.
        remarks: Lines before the header, and comments.
    """

    path: Path
    header: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    separator: str
    decimal: str
    remarks: tuple[str, ...]

    def number(self, row: int, column: int) -> float:
        """Return one field as a number.

        Raises:
            RecordingError: It is none.
        """
        text = self.rows[row][column].strip()
        value = number_of(text, self.decimal)
        if value is None:
            name = self.header[column] if self.header else str(column + 1)
            place = f"line {self.lines[row]}, column {name}"
            raise RecordingError(self.path, place, quoted(text), f"a number (decimal mark {quoted(self.decimal)})")
        return value


def number_of(text: str, decimal: str) -> float | None:
    """Return the number that a field holds, None if it is none; `1.234,5` is read with a decimal comma."""
    text = text.strip()
    if _GROUPED[decimal].fullmatch(text):
        text = text.replace("." if decimal == "," else ",", "")
    elif not _NUMBER[decimal].fullmatch(text):
        return None
    return float(text.replace(",", "."))


def split_line(line: str, separator: str) -> list[str]:
    """Return the fields of a line; quotes are honoured, and a separator at the end begins no field."""
    if separator == BLANKS:
        fields = line.split()
    else:
        fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    while fields and not fields[-1].strip():
        fields.pop()
    return [field.strip() for field in fields]


def read_grid(
    text: Text, separator: str | None = None, decimal: str | None = None, header_line: int | None = None
) -> Grid:
    """Find the table in a text.

    Args:
        text: The file.
        separator: None: found.
        decimal: `.` or `,`; None: found.
        header_line: Line number of the header; 0: there is none; None: found.

    Raises:
        RecordingError: No table is found, or its decimal mark is ambiguous.
    """
    for candidate in (separator,) if separator else (*SEPARATORS, BLANKS):
        for mark in (decimal,) if decimal else ((".",) if candidate == "," else (".", ",")):
            found = _data(text.lines, candidate, mark)
            if found is not None:
                lines, rows = found
                if decimal is None and candidate != ",":
                    _refuse_ambiguous(text, rows, lines)
                return _framed(text, candidate, mark, lines, rows, header_line)
    expected = f"rows of at least {LEAST_NUMBERS} numbers, separated by tab, semicolon, bar, comma or blanks"
    raise RecordingError(text.path, "", "no table", expected)


def _data(lines: Sequence[str], separator: str, decimal: str) -> tuple[list[int], list[list[str]]] | None:
    """Return indices and fields of the rows of data, or None if this separator makes no table."""
    numbered = []
    for index, line in enumerate(lines):
        if line.strip() and not COMMENT.match(line):
            fields = split_line(line, separator)
            if sum(number_of(field, decimal) is not None for field in fields) >= LEAST_NUMBERS:
                numbered.append((index, fields))
    if not numbered:
        return None
    width, count = Counter(len(fields) for _, fields in numbered).most_common(1)[0]
    after = sum(bool(line.strip()) and not COMMENT.match(line) for line in lines[numbered[0][0] :])
    if count < 0.8 * after:
        return None
    kept = [(index, fields) for index, fields in numbered if len(fields) == width]
    return [index for index, _ in kept], [fields for _, fields in kept]


def _refuse_ambiguous(text: Text, rows: list[list[str]], lines: list[int]) -> None:
    """Refuse a table in which every number with a comma could have thousands marked by it."""
    commas = [(row, field) for row, fields in enumerate(rows) for field in fields if "," in field]
    numbers = [(row, field) for row, field in commas if _NUMBER[","].fullmatch(field)]
    if numbers and all(_COULD_BE_THOUSANDS.fullmatch(field) for _, field in numbers):
        row, field = numbers[0]
        raise RecordingError(
            text.path,
            f"line {lines[row] + 1}",
            quoted(field),
            "a number that can be read in one way only: give `decimal`",
        )


def _framed(
    text: Text, separator: str, decimal: str, lines: list[int], rows: list[list[str]], header_line: int | None
) -> Grid:
    width = len(rows[0])
    first = lines[0]
    above = [
        (index, split_line(COMMENT.sub("", line), separator))
        for index, line in enumerate(text.lines[:first])
        if line.strip()
    ]
    header: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    used = first
    if header_line is None:
        for index, fields in reversed(above):
            if len(fields) == width and not units and _are_units(fields):
                units, used = tuple(fields), index
            elif len(fields) == width and any(not _is_number(field) for field in fields):
                header, used = tuple(fields), index
                break
            elif not units:
                break  # the header stands directly above the data
    elif header_line > 0:
        found = next((fields for index, fields in above if index == header_line - 1), None)
        if found is None or len(found) != width:
            here = f"{len(found)} names" if found else "no header"
            raise RecordingError(text.path, f"line {header_line}", here, f"the names of {width} columns")
        header, used = tuple(found), header_line - 1
        below = next((fields for index, fields in above if index > used), None)
        units = tuple(below) if below and len(below) == width and _are_units(below) else ()
    remarks = tuple(line.strip() for line in text.lines[:used] if line.strip())
    remarks += tuple(line.strip() for line in text.lines[first:] if COMMENT.match(line))
    numbers = tuple(index + 1 for index in lines)
    return Grid(text.path, header, units, tuple(map(tuple, rows)), numbers, separator, decimal, remarks)


def _are_units(fields: Sequence[str]) -> bool:
    named = [unit_of(field) for field in fields if field.strip(" -[]()")]
    return bool(named) and all(unit is not None for unit in named)


def _is_number(field: str) -> bool:
    return any(number_of(field, mark) is not None for mark in ".,")
