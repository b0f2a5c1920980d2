"""Rows and columns of a text table: separator, decimal mark, header and units row are found, not asked for."""

from __future__ import annotations

import csv
import dataclasses
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.foreign.meaning import AXES, IGNORED, dimension_of, meanings
from calibration_core.recording.foreign.text import EXPORT, Text
from calibration_core.recording.foreign.units import split_unit, unit_of

SEPARATORS = ("\t", ";", "|", ",")  # blanks are tried last, because names contain them
BLANKS = " "
LEAST_NUMBERS = 3  # in a row of data: the coordinates of a point
NAMED = 2  # names of columns that are understood make a line above the data a header
READABLE = 0.5  # share of the rows below the first row of data that a separator must make readable
COMMENT = re.compile(r"^\s*(?:#|//|!|%|\*|;(?=\s*[A-Za-z]))+\s*")
_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(?:\d+,?\d*|,\d+)(?:[eE][+-]?\d+)?"),
}
_GROUPED = {
    ".": re.compile(r"[+-]?\d{1,3}(?:,\d{3})+(?:\.\d*)?"),
    ",": re.compile(r"[+-]?\d{1,3}(?:\.\d{3})+(?:,\d*)?"),
}
MINUS = {0x2212: "-", 0x2013: "-"}
_GROUPING = re.compile(r"(?<=\d)[ '’\u00a0\u2009\u202f](?=\d{3}(?!\d))")
_SPACED = re.compile(r"[+-]?\d{1,3}(?:[ '’\u00a0\u2009\u202f]\d{3})+(?:[.,]\d*)?$")

_WORD = re.compile(r'"([^"]*)"(?!\S)|(\S+)')
_OF_POINT = re.compile(r"(.+?)[ _.:/-]+([xyz])|([xyz])[ _.:/-]*(.+)", re.IGNORECASE)

_Line = tuple[int, list[str]]  # index and fields


@dataclasses.dataclass(frozen=True)
class Grid:
    """A table as text.

    Attributes:
        path: The file.
        header: Names of the columns; empty if the file has none.
        units: Row of units below the header; empty if there is none.
        rows: Fields of all rows of data, all equally many; what is missing at the end of a row is empty.
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
            beside = "in every row; what was measured at other times stands in a file of its own, joined by time"
            raise self.fault(
                row, column, f"a finite number {f'(decimal mark {quoted(self.decimal)})' if text else beside}"
            )
        return value

    def fault(self, row: int, column: int, expected: str) -> RecordingError:
        """Return an error at a field."""
        name = self.header[column] if self.header else str(column + 1)
        place = f"line {self.lines[row]}, column {name}"
        return RecordingError(self.path, place, quoted(self.rows[row][column]), expected)


def number_of(text: str, decimal: str) -> float | None:
    """Return the finite number that a field holds, None if it is none; `1.234,5` is read with a decimal comma.

    A typographic minus is a minus; blanks and apostrophes may group the digits before the decimal mark by threes.
    """
    text = text.strip().translate(MINUS)
    if _SPACED.match(text):
        text = _GROUPING.sub("", text)
    if _GROUPED[decimal].fullmatch(text):
        text = text.replace("." if decimal == "," else ",", "")
    elif not _NUMBER[decimal].fullmatch(text):
        return None
    value = float(text.replace(",", "."))
    return value if math.isfinite(value) else None


def split_line(line: str, separator: str) -> list[str]:
    """Return the fields of a line; quotes are honoured, and a separator at the end begins no field.

    Between blanks an empty field stands in quotes, and counts.
    """
    if separator == BLANKS:
        return [quoted.strip() or plain for quoted, plain in _WORD.findall(line)]
    fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    while fields and not fields[-1].strip():
        fields.pop()
    return [field.strip() for field in fields]


def read_grid(
    text: Text, separator: str | None = None, decimal: str | None = None, header_line: int | None = None
) -> Grid:
    """Find the table in a text; below its header, all but empty lines, comments and a repeated header are data.

    Args:
        text: The file.
        separator: None: found.
        decimal: `.` or `,`; None: found.
        header_line: Line number of the header; 0: there is none; None: found.

    Raises:
        RecordingError: No table is found, its decimal mark is ambiguous, or a row has more fields than columns.
    """
    for candidate in (separator,) if separator else (*SEPARATORS, BLANKS):
        read = {mark: _data(text.lines, candidate, mark) for mark in ([decimal] if decimal else [".", ","])}
        mark = max(read, key=lambda mark: _numbers(read[mark], mark))
        found = read[mark]
        if found is not None:
            if decimal is None:
                _refuse_ambiguous(text, candidate, mark, found[0][0])
            return _framed(text, candidate, mark, found, header_line)
    expected = f"rows of at least {LEAST_NUMBERS} numbers, separated by tab, semicolon, bar, comma or blanks"
    raise RecordingError(text.path, "", "no table", f"{expected}; {EXPORT}")


def _numbers(rows: Sequence[_Line] | None, decimal: str) -> int:
    return sum(number_of(field, decimal) is not None for _, fields in rows or () for field in fields)


def _data(lines: Sequence[str], separator: str, decimal: str) -> list[_Line] | None:
    """Return the rows of data that are plain at once, or None if this separator makes no table."""
    numbered = []
    for index, line in enumerate(lines):
        if not _is_comment(line, separator):
            fields = split_line(line, separator)
            if sum(number_of(field, decimal) is not None for field in fields) >= LEAST_NUMBERS:
                numbered.append((index, fields))
    if not numbered:
        return None
    width, _ = Counter(len(fields) for _, fields in numbered).most_common(1)[0]
    first = numbered[0][0]
    plain = [(index, fields) for index, fields in numbered if len(fields) == width]
    after = sum(bool(split_line(line, separator)) and not _is_comment(line, separator) for line in lines[first:])
    return plain if len(plain) >= READABLE * after else None


def _refuse_ambiguous(text: Text, separator: str, decimal: str, first: int) -> None:
    """Refuse a table whose commas could mark thousands or decimals, unless a number with both marks settles it."""
    lines = [(index, split_line(line, separator)) for index, line in enumerate(text.lines[first:], first)]
    commas = [(index, field.translate(MINUS)) for index, fields in lines for field in fields if "," in field]
    if any(_SPACED.match(field) or (decimal in field and _GROUPED[decimal].fullmatch(field)) for _, field in commas):
        return
    numbers = [(index, field) for index, field in commas if _NUMBER[","].fullmatch(field)]
    doubtful = [(index, field) for index, field in numbers if _GROUPED["."].fullmatch(field)]
    if doubtful and (decimal == "." or len(doubtful) == len(numbers)):
        index, field = doubtful[0]
        expected = 'a number that can be read in one way only: state `decimal: "."` or `decimal: ","` in a map'
        raise RecordingError(text.path, f"line {index + 1}", quoted(field), expected)


def _framed(text: Text, separator: str, decimal: str, plain: Sequence[_Line], header_line: int | None) -> Grid:
    first, width = plain[0][0], len(plain[0][1])
    begin = number_of(plain[0][1][0], decimal)
    counted = len(plain) > 1 and all(number_of(row[0], decimal) == (begin or 0) + k for k, (_, row) in enumerate(plain))
    above = [
        (index, _named_fields(line, separator, width, counted=counted))
        for index, line in enumerate(text.lines[:first])
        if line.strip()
    ]

    def data(index: int, fields: Sequence[str]) -> bool:
        numbers = sum(number_of(field, decimal) is not None for field in fields)
        least = 1 if len(fields) == width else LEAST_NUMBERS
        return numbers >= least and not _is_comment(text.lines[index], separator)

    header: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    used = first
    if header_line:
        found = next((fields for index, fields in above if index == header_line - 1), None)
        if found is None or len(found) < width:
            here = f"{len(found)} names" if found else "no header"
            raise RecordingError(text.path, f"line {header_line}", here, f"the names of {width} columns")
        header, used = tuple(found), header_line - 1
        below = next((fields for index, fields in above if index > used), None)
        units = tuple(below) if below and len(below) == width and _are_units(below) else ()
        first = header_line
    else:
        for index, fields in reversed(above):
            if data(index, fields):
                first = used = index  # with a field that is no number where one is expected
            elif header_line == 0:
                break
            elif len(fields) == width and not units and _are_units(fields):
                units, used = tuple(fields), index
            else:
                header = _header(text, index, fields, separator, width)
                used = index if header else used
                if header or not units:
                    break  # the header stands directly above the data
    width = max(width, len(header))  # its last columns may be empty in every row
    rows = list(_rows(text, separator, first, (header, units), width))
    remarks = tuple(line.strip() for line in text.lines[:used] if line.strip())
    remarks += tuple(line.strip() for line in text.lines[first:] if _is_comment(line, separator))
    numbers = tuple(index + 1 for index, _ in rows)
    units = (*units, *[""] * (width - len(units))) if units else ()
    return Grid(text.path, header, units, tuple(fields for _, fields in rows), numbers, separator, decimal, remarks)


def _named_fields(line: str, separator: str, width: int, *, counted: bool) -> list[str]:
    """Return the fields of a line above the data, which may be a comment, or begin with `#` for the number.

    Between blanks it is the number where there are as many columns, or where the first column counts the rows,
    a coordinate or an angle comes next, and the last name is of a column that may be empty.
    """
    whole = split_line(line, separator)
    plain = split_line(COMMENT.sub("", line), separator)
    if whole[:1] != ["#"] or not plain:
        return plain
    found = [meaning or IGNORED for meaning in meanings([split_unit(field)[0] for field in plain])]
    second = counted and dimension_of(found[0]) in {"length", "angle"} and found[-1] == IGNORED
    return whole if separator != BLANKS or len(whole) == width or second else plain


def _header(text: Text, index: int, fields: Sequence[str], separator: str, width: int) -> tuple[str, ...]:
    """Return the names of the columns where a line above the data holds them; empty where it is another line.

    Raises:
        RecordingError: It names other columns than there are.
    """
    names = _with_brackets(fields) if separator == BLANKS and len(fields) != width else fields
    if len(names) == width:
        return tuple(names)
    understood = sum(meaning is not None for meaning in meanings([split_unit(field)[0] for field in names]))
    if understood < NAMED:
        return ()
    if len(names) < width or separator == BLANKS:
        expected = f"{width} fields, one for each column of data; or `header: 0` and `columns` in a map"
        raise RecordingError(text.path, f"line {index + 1}", f"{len(names)} names of columns", expected)
    return tuple(names)


def _rows(
    text: Text, separator: str, first: int, headers: Sequence[tuple[str, ...]], width: int
) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield index and fields of every row of data: what is neither empty, nor a comment, nor the header once more.

    Raises:
        RecordingError: A row has more fields than there are columns, or fewer where no header or blanks tell which.
    """
    for index, line in enumerate(text.lines[first:], first):
        fields = split_line(line, separator)
        if not fields or _is_comment(line, separator) or tuple(fields) in headers:
            continue
        if len(fields) > width or (len(fields) < width and (separator == BLANKS or not headers[0])):
            found = f"{len(fields)} fields ({quoted(line.strip())})"
            place, cure = f"line {index + 1}, column {min(len(fields), width) + 1}", "" if headers[0] else f"; {EXPORT}"
            raise RecordingError(text.path, place, found, f"{width} fields, one for each column{cure}")
        yield index, (*fields, *[""] * (width - len(fields)))


def _is_comment(line: str, separator: str) -> bool:
    """Say whether a line is a comment; a semicolon that separates columns begins none."""
    return bool(COMMENT.match(line)) and not (separator == ";" and line.lstrip().startswith(";"))


def _with_brackets(fields: Sequence[str]) -> list[str]:
    """Return fields with what stands in brackets put to the one before: `X`, `[mm]` is one name."""
    joined: list[str] = []
    for field in fields:
        if joined and field[:1] in "[(":
            joined[-1] += f" {field}"
        else:
            joined.append(field)
    return joined


def one_point_a_row(grid: Grid) -> Grid:
    """Return a table whose rows hold several points (`mp1 X`, `mp1 Y`, ... or `X1`, `Y1`, ...) with one in each row.

    The columns of the other points are left out, and `point`, `x`, `y`, `z` put behind the others.
    """
    split = [split_unit(field) for field in grid.header]
    known = meanings([name for name, _ in split])
    points: dict[str, dict[str, int]] = {}
    for i, (name, _) in enumerate(split):
        found = _OF_POINT.fullmatch(name.strip())
        if known[i] is None and found is not None:
            label = (found.group(1) or found.group(4)).strip(" _-.:/")
            points.setdefault(label, {})[(found.group(2) or found.group(3)).lower()] = i
    whole = {label: axes for label, axes in points.items() if label and set(axes) == set(AXES)}
    if len(whole) < 2 or set(AXES) & set(known):
        return grid
    taken = {i for axes in whole.values() for i in axes.values()}
    others = [i for i in range(len(split)) if i not in taken]

    def arranged(fields: Sequence[str], label: str, axes: Mapping[str, int]) -> tuple[str, ...]:
        return (*(fields[i] for i in others), label, *(fields[axes[axis]] for axis in AXES))

    first = next(iter(whole.values()))
    units = [split[first[axis]][1] for axis in AXES]
    for label, axes in whole.items():
        if [split[axes[axis]][1] for axis in AXES] != units:
            other = f"{label} in another unit than {next(iter(whole))}"
            raise RecordingError(grid.path, "header", other, "targets of a row in one unit, or one target in a row")
    names = tuple(axis if unit is None else f"{axis} [{unit.name}]" for axis, unit in zip(AXES, units, strict=True))
    return dataclasses.replace(
        grid,
        header=(*(grid.header[i] for i in others), "point", *names),
        units=arranged(grid.units, "", first) if grid.units else (),
        rows=tuple(arranged(row, label, axes) for row in grid.rows for label, axes in whole.items()),
        lines=tuple(line for line in grid.lines for _ in whole),
    )


def _are_units(fields: Sequence[str]) -> bool:
    named = [unit_of(field) for field in fields if field.strip(" -[]()")]
    return bool(named) and all(unit is not None for unit in named)


def _is_number(field: str) -> bool:
    return any(number_of(field, mark) is not None for mark in ".,")
