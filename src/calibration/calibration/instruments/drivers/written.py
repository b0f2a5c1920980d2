"""Drivers `file` and `manual`: a person, or another program, measures the target that is shown, and writes it down."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calibration.instruments.drivers import AXES, DriverError, Seen, Wait
from calibration_core.errors import quoted
from calibration_core.timeseries import NANOSECONDS, Float1D

DEVIATIONS = ("sx", "sy", "sz")
Row = dict[str, str]


class Written:
    """Takes the rows that are written after a target was shown, until the window is over and there is one."""

    by_hand = True

    def __init__(self, name: str, unit: float) -> None:
        """Take where is written, for a person, and metres per unit of the numbers."""
        self.name, self.awaited = name, ""
        self._unit, self._point = unit, ""

    def aim(self, point: str, place: Float1D, wait: Wait) -> None:  # noqa: ARG002  # a person sees where the target is
        """Forget what was written before."""
        self._point, self.awaited = point, f"nobody has written it into {self.name}"
        self._forget()

    def measure(self, window: float, wait: Wait) -> list[Seen]:
        """Wait for rows."""
        first = begin = wait()
        found: list[Seen] = []
        while not found or wait() < first + window * NANOSECONDS:
            for row in self._rows():
                found.append(self._seen(row, begin, max(wait(), begin + 1)))
                begin = found[-1].end
            wait()
        return found

    def close(self) -> None:
        """Nothing is held."""

    def _seen(self, row: Row, begin: int, end: int) -> Seen:
        if row.get("point", self._point) != self._point:
            raise DriverError(f"{row['point']} stands in {self.name} where {self._point} was to be measured")
        place, sigma = ([self._number(row[axis]) for axis in axes if axis in row] for axes in (AXES, DEVIATIONS))
        covariance = np.diag(np.array(sigma) ** 2) if len(sigma) == len(AXES) else None
        return Seen(begin, end, np.array(place), covariance)

    def _number(self, text: str) -> float:
        try:
            return self._unit * float(text)
        except ValueError:
            raise DriverError(f"{self.name}: found {quoted(text)}, expected a number") from None

    def _forget(self) -> None:
        raise NotImplementedError

    def _rows(self) -> Iterator[Row]:
        raise NotImplementedError


class Table(Written):
    """A file with a header to which rows are appended; columns `x y z`, and, if any, `point sx sy sz`."""

    def __init__(self, path: Path, unit: float) -> None:
        """Take the file; it may be made later."""
        super().__init__(str(path), unit)
        self._path, self._read, self._columns = path, 0, list[str]()

    def _forget(self) -> None:
        self._read = 0
        self._columns = next(map(fields, self._lines()), [])

    def _rows(self) -> Iterator[Row]:
        for line in filter(str.strip, self._lines()):
            values = fields(line)
            if not self._columns:
                self._columns = values
            elif not set(AXES) <= set(self._columns):
                raise DriverError(f"{self.name}: found the columns {', '.join(self._columns)}, expected x, y, z")
            elif len(values) != len(self._columns):
                raise DriverError(f"{self.name}: found {quoted(line)}, expected {', '.join(self._columns)}")
            else:
                yield dict(zip(self._columns, values, strict=True))

    def _lines(self) -> list[str]:
        """Return the whole lines that are new; the last is not taken before it is ended."""
        try:
            data = self._path.read_bytes() if self._path.exists() else b""
        except OSError as error:
            raise DriverError(f"{self.name} cannot be read: {error.strerror}") from error
        if len(data) < self._read:
            raise DriverError(f"{self.name} has become shorter: rows are only appended to it")
        new = data[self._read : data.rfind(b"\n") + 1]
        self._read += len(new)
        return new.decode("utf-8-sig", "replace").splitlines()


class Typed(Written):
    """Lines that an operator types or pastes: `x y z`, or `point x y z`."""

    def __init__(self, name: str, unit: float) -> None:
        """Take where is typed, for a person."""
        super().__init__(name, unit)
        self._typed: deque[Row] = deque()

    def type(self, line: str) -> str:
        """Take a line; return what is wrong with it, empty if nothing is."""
        values = fields(line.strip())
        columns = AXES if len(values) == len(AXES) else ("point", *AXES)
        if len(values) != len(columns) or not all(re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", one) for one in values[-3:]):
            return f"found {quoted(line)}, expected three numbers, or a point and three numbers"
        self._typed.append(dict(zip(columns, values, strict=True)))
        return ""

    def _forget(self) -> None:
        self._typed.clear()

    def _rows(self) -> Iterator[Row]:
        while self._typed:
            yield self._typed.popleft()


def fields(line: str) -> list[str]:
    """Return what stands between semicolons, tabs, commas or blanks; beside the first two a comma is a decimal one."""
    for separator in (";", "\t", ","):
        if separator in line:
            return [one.strip().replace(",", ".") for one in line.split(separator)]
    return line.split()
