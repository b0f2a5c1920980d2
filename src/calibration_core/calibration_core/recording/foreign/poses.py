"""Joint angles as robot programs hold them: KUKA KRL, ABB RAPID, FANUC TP listings, Universal Robots scripts."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.foreign.inference import LARGEST_TURN
from calibration_core.recording.foreign.text import EXPORT, Text

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_UNUSED = 8e9  # what RAPID writes for an external axis that is not there: 9E9
_KUKA = re.compile(r"(?:(\w+)\s*=\s*)?\{[^{}]*?\b(A1\s+[^{}]*)\}", re.IGNORECASE)
_KUKA_AXIS = re.compile(rf"\b([AE]\d)\s+({_NUMBER})", re.IGNORECASE)
_KUKA_PLACE = re.compile(r"\{[^{}]*?\bX\s+[^{}]*\bY\s+[^{}]*\}", re.IGNORECASE)
_RAPID = re.compile(
    r"(?:jointtarget\s+(\w+)\s*:=\s*|MoveAbsJ\s*(?:\\\w+\s*,?\s*)?)"
    r"\[\s*\[([^\]]*)\]\s*(?:,\s*\[([^\]]*)\])?", re.IGNORECASE,
)  # fmt: skip
_RAPID_ARRAY = re.compile(r"jointtarget\s+\w+\s*\{[^}]*\}\s*:=\s*\[(.*?)\]\s*;", re.IGNORECASE | re.DOTALL)
_RAPID_ELEMENT = re.compile(r"()\[\s*\[([^\]]*)\]\s*,\s*\[([^\]]*)\]\s*\]")
_RAPID_PLACE = re.compile(r"robtarget\s+\w+\s*:=|Move[JLC]\s*\[", re.IGNORECASE)
_FANUC = re.compile(r"P\[\s*(\d+)[^\]]*\]\s*\{(.*?)\}\s*;", re.DOTALL)
_FANUC_GROUP = re.compile(r"GP\s*(\d)\s*:")
_FANUC_AXIS = re.compile(rf"\b([JE]\d)\s*=\s*({_NUMBER})\s*(deg|mm)")
_SCRIPT = re.compile(r"(?:(\w+)\s*=\s*|((?:move[jlpc]|servoj)\s*\(\s*))(p?)\[([^\]]*)\]")
_SCRIPT_ANGLE = re.compile(rf"({_NUMBER})|d2r\(\s*({_NUMBER})\s*\)")
_SCRIPT_MOVES = re.compile(r"(?:move[jlpc]|servoj)\s*\(\s*(\w+)")


@dataclasses.dataclass(frozen=True)
class Poses:
    """Configurations of a robot program, in the order of the file.

    Attributes:
        language: Whose program it is.
        names: Of the positions, empty where the program names none.
        units: Axis, as the program calls it, -> unit in which it is stated; empty where the program does not say.
        values: Axis -> its value in each position, in that unit.
        lines: Line of each position.
    """

    path: Path
    language: str
    names: tuple[str, ...]
    units: Mapping[str, str]
    values: Mapping[str, tuple[float, ...]]
    lines: tuple[int, ...]


class _Position(NamedTuple):
    """A position: where it stands in the text, its name, and axis -> value and unit."""

    at: int
    name: str
    axes: dict[str, tuple[float, str]]


class _UnreadableError(Exception):
    """What cannot be read, and where it stands in the text."""

    def __init__(self, at: int, found: str) -> None:
        super().__init__(found)
        self.at, self.found = at, found


@dataclasses.dataclass(frozen=True)
class _Language:
    """How the programs of a maker are read.

    Attributes:
        name: Of the language.
        program: What tells a program from a table.
        remark: Its remarks, which hold no positions.
        positions: Yields the positions in joint angles of a text without remarks.
        place: A position in Cartesian coordinates.
    """

    name: str
    program: re.Pattern[str]
    remark: re.Pattern[str]
    positions: Callable[[str], Iterator[_Position]]
    place: re.Pattern[str]


def read_poses(text: Text) -> Poses | None:
    """Return the joint configurations of a robot program; None if the text is no such program.

    Raises:
        RecordingError: The positions of one program have different axes or are Cartesian ones, or a number cannot be
            read; with its line.
    """
    whole = "\n".join(text.lines)
    for language in LANGUAGES:
        bare = language.remark.sub(lambda remark: " " * len(remark.group()), whole)
        if language.program.search(bare) is None:
            continue
        try:
            found = list(language.positions(bare))
        except _UnreadableError as fault:
            expected = f"a joint angle; {EXPORT}"
            raise RecordingError(text.path, _line(bare, fault.at), fault.found, expected) from None
        if not found:
            place = language.place.search(bare)
            if place is not None:
                expected = "positions in joint angles, which a Cartesian one does not tell"
                at = _line(bare, place.start())
                raise RecordingError(text.path, at, f"Cartesian positions ({language.name})", expected)
            continue
        axes = list(found[0].axes)
        for one in found:
            if list(one.axes) != axes or sum(axis[0] != "E" for axis in axes) < 3:
                listed = f"axes {', '.join(one.axes)}"
                expected = f"those of the first position ({', '.join(axes)}), at least 3"
                raise RecordingError(text.path, _line(bare, one.at), listed, expected)
        names = tuple(one.name for one in found)
        return Poses(
            text.path,
            language.name,
            names if all(names) else (),
            {axis: found[0].axes[axis][1] for axis in axes},
            {axis: tuple(one.axes[axis][0] for one in found) for axis in axes},
            tuple(bare.count("\n", 0, one.at) + 1 for one in found),
        )
    return None


def _line(text: str, at: int) -> str:
    return f"line {text.count(chr(10), 0, at) + 1}"


def _kuka(whole: str) -> Iterator[_Position]:
    for match in _KUKA.finditer(whole):
        axes = {axis.upper(): float(value) for axis, value in _KUKA_AXIS.findall(match.group(2))}
        ordered = sorted(axes, key=lambda axis: (axis[0] == "E", axis))
        yield _Position(match.start(2), match.group(1) or "", {
            axis: (axes[axis], "" if axis[0] == "E" else "deg") for axis in ordered
        })  # fmt: skip


def _rapid(whole: str) -> Iterator[_Position]:
    arrays = [_RAPID_ELEMENT.finditer(whole, *array.span(1)) for array in _RAPID_ARRAY.finditer(whole)]
    for match in sorted((*_RAPID.finditer(whole), *itertools.chain(*arrays)), key=lambda one: one.start(2)):
        angles = _numbers(match.group(2), match.start(2))
        further = _numbers(match.group(3), match.start(3)) if match.group(3) else []
        axes = {f"J{i + 1}": (value, "deg") for i, value in enumerate(angles)}
        axes |= {f"E{i + 1}": (value, "") for i, value in enumerate(further) if abs(value) < _UNUSED}
        yield _Position(match.start(2), match.group(1) or "", axes)


def _fanuc(whole: str) -> Iterator[_Position]:
    """Yield the positions of motion group 1; axes of other groups are external ones."""
    for match in _FANUC.finditer(whole):
        axes: dict[str, tuple[float, str]] = {}
        group = "1"
        parts = _FANUC_GROUP.split(match.group(2))
        for k, part in enumerate(parts):
            if k % 2:
                group = part
                continue
            for axis, value, unit in _FANUC_AXIS.findall(part):
                axes[axis if group == "1" else f"E{group}.{axis}"] = float(value), unit
        if any(axis[0] == "J" for axis in axes):  # else a Cartesian position, which has no joint angles
            yield _Position(match.start(), match.group(1), axes)


def _script(whole: str) -> Iterator[_Position]:
    """Yield the lists that the robot moves to; where it moves to none that is written out, those of six joints."""
    moved = set(_SCRIPT_MOVES.findall(whole))
    lists = [match for match in _SCRIPT.finditer(whole) if not match.group(3)]  # p[...] is a Cartesian pose
    chosen = [match for match in lists if match.group(2) or match.group(1) in moved]
    for match in chosen or [match for match in lists if match.group(4).count(",") == 5]:
        angles, at = [], match.start(4)
        for field in match.group(4).split(","):
            angle = _SCRIPT_ANGLE.fullmatch(field.strip())
            if angle is None:
                raise _UnreadableError(at, quoted(field.strip()))
            if angle.group(1) and abs(float(angle.group(1))) > LARGEST_TURN:
                raise _UnreadableError(at, f"{angle.group(1)} rad, more than a turn")
            angles.append(float(angle.group(1)) if angle.group(1) else math.radians(float(angle.group(2))))
        yield _Position(at, match.group(1) or "", {f"J{i + 1}": (value, "rad") for i, value in enumerate(angles)})


def _numbers(text: str, at: int) -> list[float]:
    fields = [field.strip() for field in text.split(",")]
    for field in fields:
        if not re.fullmatch(_NUMBER, field):
            raise _UnreadableError(at, quoted(field))
    return [float(field) for field in fields]


LANGUAGES = (
    _Language(
        "ABB RAPID", re.compile(r"\b(?:jointtarget|robtarget|MoveAbsJ)\b", re.IGNORECASE), re.compile(r"!.*"), _rapid,
        _RAPID_PLACE,
    ),
    _Language(
        "FANUC TP", re.compile(r"^\s*/(?:PROG|POS|MN)\b|P\[\s*\d+[^\]]*\]\s*\{", re.MULTILINE),
        re.compile(r"^\s*(?:\d+:)?\s*(?:!|//).*", re.MULTILINE), _fanuc, _FANUC,
    ),
    _Language(
        "KUKA KRL", re.compile(r"\b(?:E6AXIS|AXIS|E6POS|DEFDAT|DEF|S?PTP)\b|\{\s*A1\s", re.IGNORECASE),
        re.compile(r";.*"), _kuka, _KUKA_PLACE,
    ),
    _Language(
        "Universal Robots script",
        re.compile(r"\bdef\s+\w+\s*\(|\b(?:move[jlpc]|servoj)\s*\(|^\s*\w+\s*=\s*p?\[", re.MULTILINE),
        re.compile(r"#.*"), _script, re.compile(r"p\["),
    ),
)  # fmt: skip
