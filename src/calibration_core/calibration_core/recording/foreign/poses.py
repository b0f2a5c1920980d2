"""Joint angles as robot programs hold them: KUKA KRL, ABB RAPID, FANUC TP listings, Universal Robots scripts."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator
from pathlib import Path

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.foreign.text import Text

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_KUKA = re.compile(r"(?:(\w+)\s*=\s*)?\{[^{}]*?(A1\s+[^{}]*)\}", re.IGNORECASE)
_KUKA_AXIS = re.compile(rf"\bA(\d)\s+({_NUMBER})", re.IGNORECASE)
_RAPID = re.compile(r"jointtarget\s+(\w+)\s*:=\s*\[\s*\[([^\]]*)\]", re.IGNORECASE)
_FANUC = re.compile(r"P\[\s*(\d+)[^\]]*\]\s*\{(.*?)\}\s*;", re.DOTALL)
_FANUC_AXIS = re.compile(rf"\bJ(\d)\s*=\s*({_NUMBER})\s*deg")
_SCRIPT = re.compile(r"(?:(\w+)\s*=\s*|move[jlp]\s*\(\s*)\[([^\]]*)\]")


@dataclasses.dataclass(frozen=True)
class Poses:
    """Configurations of a robot program, in the order of the file.

    Attributes:
        path: The file.
        language: Whose program it is.
        names: Of the positions, empty where the program names none.
        q: Joint angles, rad.
        unit: Unit in which the program states them.
    """

    path: Path
    language: str
    names: tuple[str, ...]
    q: tuple[tuple[float, ...], ...]
    unit: str


def read_poses(text: Text) -> Poses | None:
    """Return the joint configurations of a robot program; None if the text is no such program.

    Raises:
        RecordingError: The positions of one program have different numbers of joints, or a number cannot be read.
    """
    whole = "\n".join(text.lines)
    for language, unit, factor, reader in (
        ("ABB RAPID", "deg", math.pi / 180.0, _rapid),
        ("FANUC TP", "deg", math.pi / 180.0, _fanuc),
        ("KUKA KRL", "deg", math.pi / 180.0, _kuka),
        ("Universal Robots script", "rad", 1.0, _script),
    ):
        found = list(reader(whole))
        if found:
            counts = {len(values) for _, values in found}
            if len(counts) > 1 or min(counts) < 3:
                expected = "positions with one number of joints, at least 3"
                raise RecordingError(text.path, language, f"positions with {sorted(counts)} joints", expected)
            names = tuple(name for name, _ in found)
            q = tuple(tuple(value * factor for value in values) for _, values in found)
            return Poses(text.path, language, names if all(names) else (), q, unit)
    return None


def _kuka(whole: str) -> Iterator[tuple[str, list[float]]]:
    for match in _KUKA.finditer(whole):
        axes = {int(number): float(value) for number, value in _KUKA_AXIS.findall(match.group(2))}
        yield match.group(1) or "", [axes[i] for i in sorted(axes)]


def _rapid(whole: str) -> Iterator[tuple[str, list[float]]]:
    for match in _RAPID.finditer(whole):
        yield match.group(1), _numbers(match.group(2))


def _fanuc(whole: str) -> Iterator[tuple[str, list[float]]]:
    for match in _FANUC.finditer(whole):
        axes = {int(number): float(value) for number, value in _FANUC_AXIS.findall(match.group(2))}
        if axes:  # else a Cartesian position, which has no joint angles
            yield match.group(1), [axes[i] for i in sorted(axes)]


def _script(whole: str) -> Iterator[tuple[str, list[float]]]:
    for match in _SCRIPT.finditer(whole):
        if not re.search(r"p\s*$", whole[: match.start(2) - 1]):  # p[...] is a Cartesian pose
            yield match.group(1) or "", _numbers(match.group(2))


def _numbers(text: str) -> list[float]:
    fields = [field.strip() for field in text.split(",")]
    for field in fields:
        if not re.fullmatch(_NUMBER, field):
            raise RecordingError("robot program", quoted(text[:60]), quoted(field), "a joint angle")
    return [float(field) for field in fields]
