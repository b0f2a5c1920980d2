r"""The map of an import: what is not to be recognised but is stated (YAML).

files:
  - match: "points_*.txt"          # names of files; the first that matches counts
    encoding: cp1252               # all keys are optional; what is absent is recognised
    separator: ";"
    decimal: ","
    header: 3                      # line of the header; 0: there is none
    columns: {Zeit: time, "X ist": x, "5": ignored}    # by name, or by number from 1
    units: {x: mm, q: deg, f: kN, t: "N*m"}
    name: '(?P<configuration>\d+)-(?P<step>\d+)-(?P<point>\w+)'
join: number                       # number, order or time
tolerance: 0.5                     # s, of a join by time
points: {SMR1: mp1}                # names in the files -> names in the cell file
joint_coupling: {q3: {q2: 1.0}}    # angle of the chain = angle in the file + factor times the other's (FANUC)
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.foreign.meaning import AXES, COUNTS, FORCES, IGNORED, JOINT, NAMES, TORQUES
from calibration_core.recording.foreign.text import ENCODINGS
from calibration_core.recording.foreign.units import UNITS, ForeignUnit, unit_of

MEANINGS = (*AXES, *FORCES, *TORQUES, *COUNTS, *NAMES, "time", "temperature", IGNORED)
UNIT_KEYS = ("q", "q1 ... qn", "xyz", *AXES, "f", *FORCES, "t", *TORQUES, "time", "temperature")
GROUPS = ("configuration", "step", "point")
Text = Annotated[str, Field(max_length=1000)]
EXPECTED = {
    "files": "a list with an entry for each kind of file",
    "match": "the pattern of names of files, a text",
    "encoding": "one of " + ", ".join(ENCODINGS),
    "separator": "a tab, a semicolon, a bar, a comma or a blank, in quotes",
    "decimal": "a point or a comma, in quotes",
    "header": "the number of the line that holds the header, 0 to 100000",
    "columns": "meanings by names of columns, such as Lage: configuration",
    "units": "units by meanings, such as x: mm",
    "name": "a regular expression, a text",
    "join": "one of number, order, time",
    "tolerance": "a time in s, more than 0 and at most 3600",
    "joint_coupling": "factors by joints, such as q3: {q2: 1.0}",
    "points": "names of the cell file by names in the files, such as SMR1: mp1",
}
"""Key of the map: what is expected there."""


class FileMap(BaseModel):
    """How one kind of file is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    match: Text = "*"
    encoding: Text | None = None
    separator: Literal["\t", ";", "|", ",", " "] | None = None
    decimal: Literal[".", ","] | None = None
    header: Annotated[int, Field(ge=0, le=100_000)] | None = None
    columns: dict[str, str] = {}
    units: dict[str, str] = {}
    name: str | None = None

    @field_validator("encoding")
    @classmethod
    def _encoding(cls, value: str | None) -> str | None:
        return _choice(value, ENCODINGS)

    @field_validator("columns", mode="before")
    @classmethod
    def _columns(cls, value: object) -> object:
        if isinstance(value, dict):
            for meaning in value.values():
                if not JOINT.fullmatch(str(meaning)):
                    _choice(str(meaning), ("q1 ... qn", *MEANINGS))
            return {str(name): meaning for name, meaning in value.items()}
        return value

    @field_validator("units")
    @classmethod
    def _units(cls, value: dict[str, str]) -> dict[str, str]:
        for meaning, text in value.items():
            if not JOINT.fullmatch(meaning):
                _choice(meaning, UNIT_KEYS)
            if unit_of(text) is None:
                _choice(text, sorted({unit.name for unit in UNITS.values()}))
        return value

    @field_validator("name")
    @classmethod
    def _name(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                groups = re.compile(value).groupindex
            except re.error as error:
                raise ValueError(f"{value!r} is no regular expression: {error}") from None
            if "configuration" not in groups or not set(groups) <= set(GROUPS):
                raise ValueError("a group (?P<configuration>...), and at most groups named step and point besides")
        return value

    def unit(self, meaning: str) -> ForeignUnit | None:
        """Return the unit that is stated for a meaning: `q` stands for all joints, `f` and `t` for force and torque."""
        family = "q" if JOINT.fullmatch(meaning) else meaning[0] if meaning in (*FORCES, *TORQUES) else ""
        text = self.units.get(meaning) or (self.units.get(family) if family else None)
        if text is None and meaning in AXES:
            text = self.units.get("xyz")
        return None if text is None else unit_of(text)


class ImportMap(BaseModel):
    """What is stated of an import."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    files: tuple[FileMap, ...] = ()
    join: Literal["number", "order", "time"] | None = None
    tolerance: Annotated[float, Field(gt=0.0, le=3600.0)] = 1.0
    points: dict[str, str] = {}
    joint_coupling: dict[str, dict[str, Annotated[float, Field(allow_inf_nan=False)]]] = {}

    def of(self, path: Path) -> FileMap:
        """Return what is stated of a file."""
        return next((one for one in self.files if fnmatch.fnmatch(path.name, one.match)), FileMap())

    def check_used(self, map_file: Path, paths: Sequence[Path]) -> None:
        """Refuse an entry that fits no file: what it states would not be heeded.

        Raises:
            RecordingError: Names the entry's place in the map.
        """
        used = [self.of(path) for path in paths]
        for index, one in enumerate(self.files):
            if not any(one is entry for entry in used):
                place = f"files.{index}.match" if "match" in one.model_fields_set else f"files.{index}"
                names = ", ".join(path.name for path in paths[:8]) + (", ..." if len(paths) > 8 else "")
                expected = f"a pattern that fits one of the files ({names}) and stands before others that fit it"
                raise RecordingError(map_file, place, quoted(one.match), expected)


def import_map(path: Path, content: object) -> ImportMap:
    """Return the checked map.

    Raises:
        RecordingError: A key or a value is none of a map.
    """
    try:
        return ImportMap.model_validate({} if content is None else content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the map"
        if first["type"] == "extra_forbidden":
            keys = FileMap.model_fields if len(first["loc"]) > 1 else ImportMap.model_fields
            raise RecordingError(path, place, "an unknown key", "one of " + ", ".join(keys)) from None
        cause = first.get("ctx", {}).get("error")
        expected = _expected(first["loc"]) if cause is None else str(cause)
        raise RecordingError(path, place, quoted(first["input"]), expected) from None


def _expected(place: tuple[int | str, ...]) -> str:
    """Return what is expected at a place: the words of the deepest part of it that has any."""
    known = [EXPECTED[part] for part in place if isinstance(part, str) and part in EXPECTED]
    if place == ("files",) or len(place) > 2 or place[:1] != ("files",):
        return known[-1] if known else "a map with keys of " + ", ".join(ImportMap.model_fields)
    return "an entry with keys of " + ", ".join(FileMap.model_fields)


def _choice(value: str | None, choices: tuple[str, ...] | list[str]) -> str | None:
    if value is not None and value not in choices:
        raise ValueError("one of " + ", ".join(choices))
    return value
