"""Every error that the core raises on purpose: one root, leaves with fields.

An `InputError` is the fault of what was handed in.  Its text is one line that names the file, the place in it,
what was found and what was expected; the command line prints it and ends with exit code 2.
"""

from __future__ import annotations

import decimal
import errno
import reprlib
import shutil
import sqlite3
from pathlib import Path
from typing import Self


class CalibrationError(Exception):
    """Root of all errors raised on purpose."""


class InputError(CalibrationError):
    """The input cannot be used.

    Attributes:
        file: The file or directory at fault, or a name for what has no file.
        place: Field, topic or configuration within it; empty if it is the file as a whole.
        found: What is there, the offending value quoted.
        expected: What would have been accepted, with the valid choices where there are some.
        line: Line of the place, from 1, where it is known.
        column: Column of the place, from 1, where it is known.
        further: Errors of the same file that were found together with this one.
    """

    further: tuple[InputError, ...] = ()

    def __init__(
        self,
        file: str | Path,
        place: str,
        found: str,
        expected: str,
        line: int | None = None,
        column: int | None = None,
    ) -> None:
        """Keep the fields; newlines are folded and file names cut, so that the text stays one line."""
        self.file = str(file)
        self.place = _one_line(place, 200)
        self.found = _one_line(found)
        self.expected = _one_line(expected)
        self.line, self.column = line, column
        where = ":".join([shown_path(file), *(str(number) for number in (line, column) if number is not None)])
        where = f"{where}: {self.place}" if self.place else where
        super().__init__(f"{where}: found {self.found}, expected {self.expected}")

    def at(self, line: int, column: int) -> Self:
        """Return the same error with its place in the file.

        Args:
            line: Line of the place, from 1.
            column: Column of the place, from 1.
        """
        return type(self)(self.file, self.place, self.found, self.expected, line, column)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str, int | None, int | None]]:
        """Pickle by the fields (errors cross process borders in the batch programs)."""
        return type(self), (self.file, self.place, self.found, self.expected, self.line, self.column)


class CellError(InputError):
    """The cell file is missing, malformed or contradicts itself."""


class RecordingError(InputError):
    """A bag or measurement table is missing, malformed or empty."""


class ObservationError(InputError):
    """A recording was read, but holds nothing that can be evaluated (no plateau, no configuration, no point)."""


class ModelFileError(InputError):
    """An identified-model file is missing, malformed or belongs to another robot."""


class TaskError(InputError):
    """A task of places and wrenches is missing or malformed."""


class IdentificationError(InputError):
    """The observations do not determine what was asked for (too few configurations, collinear points, no load)."""


class PlanError(InputError):
    """No plan can be made under the given limits."""


class SessionError(InputError):
    """A session directory is missing, damaged, in use, or belongs to another plan or cell."""


class SessionGoneError(SessionError):
    """The files of a session that is being written were moved, deleted or changed by others."""


class TrajectoryError(InputError):
    """A motion cannot be carried out within the joint limits, the speed limit and the controller's number of points."""


class OutputError(InputError):
    """The output directory cannot be made or a file in it cannot be written."""


class EquilibriumError(CalibrationError):
    """The static equilibrium did not converge: the load is beyond what the joints can carry.

    Attributes:
        residual: Largest change of a joint deflection in the last iteration, rad.
        iterations: Iterations done.
    """

    def __init__(self, residual: float, iterations: int) -> None:
        """Keep both figures."""
        self.residual = residual
        self.iterations = iterations
        super().__init__(f"no static equilibrium after {iterations} iterations (last change {residual:.3g} rad)")


def storage_fault(path: str | Path, error: OSError | sqlite3.Error, expected: str) -> tuple[str, str]:
    """Return what was found and what was expected where something cannot be written.

    Args:
        path: The file or directory; it need not exist.
        error: What the system or the database says.
        expected: What would have been accepted, unless the disk is full.
    """
    if isinstance(error, OSError):
        text, full = error.strerror or str(error), error.errno in (errno.ENOSPC, errno.EDQUOT)
    else:
        text, full = str(error), getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    if not full:
        return text, expected
    there = next(one for one in (Path(path).absolute(), *Path(path).absolute().parents) if one.exists())
    room = shutil.disk_usage(there)
    found = f"a full disk: {room.free / 1024:.0f} kB of {room.total / 1024:.0f} kB left"
    less = ", less than is to be written" if room.free else ""  # what was begun has been cleared away
    return f"{found}{less} ({text})", "room to write"


def rounded_up(limit: float, digits: int = 3) -> float:
    """Return a least value as a message states it: the smallest number of so many digits that is not below it."""
    return _rounded(limit, digits, decimal.ROUND_CEILING)


def rounded_down(limit: float, digits: int = 3) -> float:
    """Return a largest value as a message states it: the largest number of so many digits that is not above it."""
    return _rounded(limit, digits, decimal.ROUND_FLOOR)


def _rounded(limit: float, digits: int, how: str) -> float:
    exact = decimal.Decimal(str(float(limit)))
    if not exact.is_finite() or not exact:
        return float(limit)
    place = decimal.Decimal(1).scaleb(exact.adjusted() - digits + 1)
    return float((exact / place).to_integral_value(how) * place)


def beyond(value: float, limit: float, places: int = 0) -> str:
    """Return a value beyond a limit with so many decimals, and as many more as show that it is beyond.

    Args:
        value: What was found.
        limit: The limit as it is stated beside it.
        places: Fewest decimals.
    """
    for digits in range(places, places + 15):
        text = f"{value:.{digits}f}"
        if value == limit or (float(text) != limit and (float(text) > limit) == (value > limit)):
            return text
    return str(value)


def apart(found: float, expected: float, tolerance: float, places: int = 0) -> tuple[str, str]:
    """Return what was found and what was expected with so many decimals, and as many more as show that they differ.

    Args:
        found: Differs from `expected` by more than the tolerance.
        expected: What it should be.
        tolerance: As it is stated beside them.
        places: Fewest decimals.
    """
    for digits in range(places, places + 15):
        texts = f"{found:z.{digits}f}", f"{expected:z.{digits}f}"
        if not abs(float(texts[0]) - float(texts[1])) <= tolerance * (1 + 1e-9):  # what is not finite is elsewhere
            return texts
    return str(found), str(expected)


def quoted(value: object, limit: int = 60) -> str:
    """Quote an offending value for a message, cut to `limit` characters; nested values cost no more than that."""
    if value is None:
        return "nothing"
    shortened = reprlib.Repr()
    shortened.maxlevel = 3  # a few hundred bytes of YAML can nest into 10^9 elements
    shortened.maxstring = shortened.maxother = shortened.maxlong = 2 * limit
    text = shortened.repr(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"


def shown_path(path: str | Path, limit: int = 200) -> str:
    """Return a path for a message: one line, cut in the middle, unprintable characters escaped."""
    text = "".join(char if char.isprintable() else ascii(char)[1:-1] for char in str(path))
    return text if len(text) <= limit else f"{text[: limit // 2]}…{text[-limit // 2 + 1 :]}"


def _one_line(text: str, limit: int = 600) -> str:
    line = " ".join(text.split())
    line = "".join(char if char.isprintable() else ascii(char)[1:-1] for char in line)
    return line if len(line) <= limit else f"{line[: limit - 1]}…"
