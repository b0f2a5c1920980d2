"""Driver `line`: a program on the tracker's computer that answers lines of text over TCP, as a template says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from pydantic import model_validator

from calibration.conversions import LENGTH_UNITS
from calibration.instruments.drivers import AXES, Connection, DriverError, Seen, Wait
from calibration.tables import Strict, read_table, shipped
from calibration_core.cell.values import FieldError
from calibration_core.errors import quoted
from calibration_core.timeseries import NANOSECONDS, Float1D

LONGEST = 10_000  # bytes of an answer
WORDS: dict[str, str | float] = {"point": "", **dict.fromkeys((*AXES, "window"), 0.0)}  # that a request may contain


class Request(Strict):
    """One line and its answer.

    Attributes:
        send: With `{point}`, `{x}`, `{y}`, `{z}` in the template's unit, and `{window}` in s (0 while it aims).
        answer: Regular expression of the whole line that answers; its groups say what is read.
        refused: That of an answer that says no; a group `why` is what is shown of it.
    """

    send: str
    answer: str
    refused: str = "(?!)"

    @model_validator(mode="after")
    def _check(self) -> Request:
        try:
            self.send.format(**WORDS)
        except (LookupError, ValueError, AttributeError):
            expected = f"a line with no other words than {{{'}, {'.join(WORDS)}}}"
            raise FieldError("send", quoted(self.send), expected) from None
        for place, text in (("answer", self.answer), ("refused", self.refused)):
            try:
                re.compile(text)
            except re.error as error:
                raise FieldError(place, quoted(text), f"a regular expression: {error}") from None
        return self


class Template(Strict):
    """How a program speaks.

    Attributes:
        source: Where that is documented.
        note: What a user of it has to know.
        units: Unit of lengths in what is sent and answered.
        end: What ends a line.
        aim: How the beam is pointed; None: the program does that itself when it measures.
        measure: Groups of its answer: `x`, `y`, `z`; and, where the program states them, `sx`, `sy`, `sz` (standard
            deviations) and `point` (which must be the one asked for).
        ignore: Lines that answer nothing.
    """

    source: str
    note: str = ""
    units: str
    end: str = "\r\n"
    aim: Request | None = None
    measure: Request
    ignore: str = "(?!)"

    @model_validator(mode="after")
    def _check(self) -> Template:
        if self.units not in LENGTH_UNITS:
            raise FieldError("units", quoted(self.units), f"one of {', '.join(LENGTH_UNITS)}")
        if not set(AXES) <= re.compile(self.measure.answer).groupindex.keys():
            raise FieldError("measure.answer", quoted(self.measure.answer), "groups x, y and z")
        return self


def load_template(name: str) -> Template:
    """Read a template: one of `config/trackers`, or a file.

    Raises:
        InputError: It cannot be used; with line and column.
    """
    own = shipped("trackers") / f"{name}.yaml"
    return read_table(own if own.is_file() else Path(name), Template, "a tracker's program")


class Line(Connection):
    """Asks one line at a time."""

    def __init__(self, address: tuple[str, int], template: Template) -> None:
        """Take host and port; the first request connects."""
        super().__init__(address)
        self._template, self._unit, self._end = template, LENGTH_UNITS[template.units], template.end.encode()
        self._words = dict(WORDS)

    def aim(self, point: str, place: Float1D, wait: Wait) -> None:
        """Connect, if need be, and ask the program to aim."""
        self._words = WORDS | {"point": point} | dict(zip(AXES, (place / self._unit).tolist(), strict=True))
        if self._template.aim is not None:
            self._ask(self._template.aim, wait)

    def measure(self, window: float, wait: Wait) -> list[Seen]:
        """Ask for places until the window is over: for one, where the program takes that long for it."""
        self._words["window"] = window
        first = begin = wait()
        found: list[Seen] = []
        while not found or begin < first + window * NANOSECONDS:
            answer = self._ask(self._template.measure, wait)
            found.append(self._seen(answer, begin, max(wait(), begin + 1)))
            begin = found[-1].end
        return found

    def _seen(self, answer: re.Match[str], begin: int, end: int) -> Seen:
        groups = answer.groupdict()
        if groups.get("point") not in (None, self._words["point"]):
            raise DriverError(f"the answer is about another point: {quoted(answer.group())}")
        try:
            place = [float(groups[axis]) for axis in AXES]
            sigma = [float(groups["s" + axis]) for axis in AXES if groups.get("s" + axis)]
        except ValueError:
            raise DriverError(f"found {quoted(answer.group())}, expected numbers") from None
        covariance = np.diag((self._unit * np.array(sigma)) ** 2) if len(sigma) == len(AXES) else None
        return Seen(begin, end, self._unit * np.array(place), covariance)

    def _ask(self, request: Request, wait: Wait) -> re.Match[str]:
        self.awaited = f"{self.name} does not answer"
        with self.closing_on_errors():
            while (line := self._line()) is not None:
                self._refuse_unless_ignored(line, "without being asked")
            self.send(request.send.format(**self._words).encode() + self._end)
            while True:
                while (line := self._line()) is None:
                    wait()
                if answer := re.fullmatch(request.answer, line):
                    return answer
                if answer := re.fullmatch(request.refused, line):
                    raise DriverError(f"{self.name} refuses: {answer.groupdict().get('why') or line}")
                self._refuse_unless_ignored(line, f"expected {quoted(request.answer)}")

    def _refuse_unless_ignored(self, line: str, why: str) -> None:
        if not re.fullmatch(self._template.ignore, line):
            raise DriverError(f"{self.name} says {quoted(line)}, {why}")

    def _line(self) -> str | None:
        """Return the next line that has come, if a whole one has."""
        closed = self.receive()
        line, end, rest = self.pending.partition(self._end)
        text = line.decode(errors="replace")
        if end:
            self.pending = rest
            return text
        if closed or len(line) > LONGEST:
            why = "it was closed by the other side" if closed else "no line has an end"
            raise self.lost(why + (f", within {quoted(text)}" if line else ""))
        if line:
            self.awaited = f"{self.name} stops within {quoted(text)}"
        return None
