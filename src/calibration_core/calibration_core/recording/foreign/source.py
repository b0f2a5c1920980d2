"""One foreign file as columns with a meaning, in SI units, and an account of what was taken for what."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration_core.errors import RecordingError, quoted
from calibration_core.recording.foreign.clock import FORMS, counted, dated, of_day, over_midnight
from calibration_core.recording.foreign.grid import BLANKS, Grid, number_of, one_point_a_row, read_grid
from calibration_core.recording.foreign.inference import Inference, angle, force, length, refuse_two_ways, travel
from calibration_core.recording.foreign.mapping import FileMap
from calibration_core.recording.foreign.meaning import (
    ANGLE,
    AXES,
    COUNTS,
    DATES,
    EXTERNAL,
    FORCES,
    IGNORED,
    JOINT,
    NAMES,
    TORQUES,
    TURNS,
    dimension_of,
    meanings,
    normal,
    of_one_family,
)
from calibration_core.recording.foreign.poses import Poses, read_poses
from calibration_core.recording.foreign.text import EXPORT, Text, read_text
from calibration_core.recording.foreign.units import (
    SI,
    UNITS,
    Dimension,
    ForeignUnit,
    split_unit,
    unit_of,
    unknown_unit,
)
from calibration_core.timeseries import Float1D, Float2D, Float3D

_STATED = re.compile(r"(?:units?|einheit(?:en)?)\b\s*[:=]?\s*(.+)", re.IGNORECASE)
_STATED_IN = re.compile(r"\b(?:in|are|lengths?:|distances?:)\s+(\w+)", re.IGNORECASE)
_CLOCKS = {"utc", "gmt", "local", "cet", "cest", "mez", "mesz"}  # stand in brackets behind a time, and are no unit
Seen = Callable[[Float2D, Float3D], Mapping[str, Float2D]]  # places (m, 3) m and axes (m, 3, 3) -> point -> (m, 3) m
UNIT_NORM = 1e-3  # of a quaternion with at least three digits
_SEPARATOR_NAMES = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma", BLANKS: "blanks"}


@dataclasses.dataclass(frozen=True)
class Taken:
    """What one column was taken for.

    Attributes:
        column: Its name in the file.
        meaning: As in the measurement table.
        unit: Unit in the file, empty for names and counts.
        how: `stated` (map, header or remark) or why it can be no other.
    """

    column: str
    meaning: str
    unit: str
    how: str


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """One file.

    Attributes:
        form: Separator, decimal mark and encoding, or whose program it is.
        numbers: Meaning -> values (m,) in SI units.
        texts: `point`, `name` or `group` -> texts (m).
        lines: Line of each row, for messages.
        taken: What the columns were taken for.
        ignored: Columns that were not used.
        files: File of each row, where several files of positions were put one below the other.
    """

    path: Path
    form: str
    numbers: Mapping[str, Float1D]
    texts: Mapping[str, tuple[str, ...]]
    lines: tuple[int, ...]
    taken: tuple[Taken, ...]
    ignored: tuple[str, ...]
    files: tuple[Path, ...] = ()

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.lines)

    @property
    def joints(self) -> int:
        """Number of joints whose angles it holds."""
        return sum(bool(JOINT.fullmatch(name)) for name in self.numbers)

    @property
    def has_points(self) -> bool:
        """Whether it holds positions."""
        return set(AXES) <= set(self.numbers)

    @property
    def has_wrench(self) -> bool:
        """Whether it holds forces."""
        return set(FORCES) <= set(self.numbers)

    def fault(self, row: int, column: str, found: str, expected: str) -> RecordingError:
        """Return an error at a row."""
        return RecordingError(self.file(row), f"line {self.lines[row]}, column {column}", found, expected)

    def file(self, row: int) -> Path:
        """Return the file of a row."""
        return self.files[row] if self.files else self.path


def read_source(
    path: Path, how: FileMap, travels: Mapping[str, float] | None = None, seen: Seen | None = None
) -> Source:
    """Read one file.

    Args:
        path: A table or a robot program.
        how: What is stated of it; everything else is recognised.
        travels: Meaning -> how far a sliding joint stands from its zero at most, m; none of the others slides.  None:
            it is not known which joints slide.
        seen: Returns where the points stand that a tool carries: rows of poses without a point are read as them.
            None: no poses of a tool are expected.

    Raises:
        RecordingError: It is no table, or a column or unit can be read in more than one way.
    """
    text = read_text(path, how.encoding)
    poses = None if how.separator else read_poses(text)
    if poses is not None and set(how.columns) <= set(poses.values):
        return _of_poses(poses, text, how)
    grid = read_grid(text, how.separator, how.decimal, how.header)
    grid = one_point_a_row(grid) if grid.header and not how.columns else grid
    names, stated = _named(grid)
    recognised = meanings(names) if grid.header else _headerless(grid, how)
    _leave_out_orientation(grid, recognised)
    turns = next((one for one in TURNS if seen is not None and set(one) <= set(recognised)), ())
    if not turns or "point" in recognised:
        recognised = [None if any(meaning in one for one in TURNS) else meaning for meaning in recognised]
    _find_others(grid, names, stated, recognised)
    found = _with_map(grid, names, recognised, how)
    _refuse_lost(grid, names, found, how)
    columns = {meaning: i for i, meaning in enumerate(found) if meaning not in (None, IGNORED)}
    ignored = tuple(names[i] for i, meaning in enumerate(found) if meaning in (None, IGNORED))
    _check_whole(grid, columns)
    numbers: dict[str, Float1D] = {}
    texts: dict[str, tuple[str, ...]] = {}
    taken = []
    remarked = _remarked(grid.remarks)
    for meaning, i in columns.items():
        if meaning in NAMES:
            texts[meaning] = tuple(row[i] for row in grid.rows)
            taken.append(Taken(names[i], meaning, "", "stated"))
            continue
        dimension = _dimension(meaning, travels)
        how_read = ""
        if dimension == "time":
            raw, how_read = _times(grid, i)
        else:
            raw = np.array([grid.number(row, i) for row in range(len(grid.rows))])
        if meaning in COUNTS:
            _check_integers(grid, i, raw)
        numbers[meaning] = raw
        unit = None if how_read else how.unit(meaning) or stated[i] or remarked.get(dimension)
        taken.append(
            Taken(
                names[i],
                meaning,
                unit.name if unit is not None else "",
                how_read or ("stated" if unit is not None else ""),
            )
        )
    taken = _converted(grid.path, numbers, taken, travels)
    form = f"{_SEPARATOR_NAMES[grid.separator]}-separated, decimal mark {quoted(grid.decimal)}, {text.encoding}"
    source = Source(path, form, numbers, texts, grid.lines, tuple(taken), ignored)
    turned = [meaning for meaning in numbers if any(meaning in one for one in TURNS)]
    return source if seen is None or not turned else _at_points(source, seen)


def _at_points(source: Source, seen: Seen) -> Source:
    """Return a source of poses with one row for each point instead.

    Raises:
        RecordingError: Four numbers are no quaternion.
    """
    from scipy.spatial.transform import Rotation  # slow to load, and most tables hold no poses

    angles, quaternion = (
        np.column_stack([source.numbers[name] for name in one]) if set(one) <= set(source.numbers) else None
        for one in TURNS
    )
    if angles is None and quaternion is not None:
        length = np.linalg.norm(quaternion, axis=1)
        for row in np.flatnonzero(~(np.abs(length - 1) <= UNIT_NORM)):
            raise source.fault(int(row), "qx qy qz qw", f"a length of {length[row]:.6g}", "a quaternion of length 1")
    turn = Rotation.from_euler("xyz", angles) if angles is not None else Rotation.from_quat(quaternion)
    places = seen(np.column_stack([source.numbers[name] for name in AXES]), turn.as_matrix())
    rows = np.repeat(np.arange(len(source)), len(places))
    position = np.stack(list(places.values()), axis=1).reshape(-1, 3).T
    return dataclasses.replace(
        source,
        numbers={name: values[rows] for name, values in source.numbers.items()}
        | dict(zip(AXES, position, strict=True)),
        texts={name: tuple(texts[row] for row in rows) for name, texts in source.texts.items()}
        | {"point": tuple(places) * len(source)},
        lines=tuple(source.lines[row] for row in rows),
    )


def _of_poses(poses: Poses, text: Text, how: FileMap) -> Source:
    """Return the joint angles of a program; its external axes where a map says which joints they are.

    Raises:
        RecordingError: An external axis moves, and no map states its joint and unit.
    """
    own = {axis: f"q{axis[1:]}" for axis in poses.values if axis[0] != "E"}
    meanings_of = {axis: how.columns.get(axis, own.get(axis, IGNORED)) for axis in poses.values}
    numbers: dict[str, Float1D] = {}
    taken, ignored = [], []
    for axis, values in poses.values.items():
        meaning, low, high = meanings_of[axis], min(values), max(values)
        unit = how.unit(meaning) or unit_of(poses.units[axis])
        if meaning == IGNORED and low != high and axis not in how.columns:
            first = next(iter(own))
            expected = (
                "the joint that it is and its unit, in a map, such as "
                f"columns: {{{axis}: q1, {first}: q2, ...}}, units: {{q1: mm}}; or {axis}: ignored"
            )
            raise RecordingError(
                text.path, f"axis {axis}", f"an external axis that moves ({low:g} to {high:g})", expected
            )
        if meaning == IGNORED:
            ignored += [f"{axis} ({low:g})"] if low or high else []
            continue
        if unit is None or unit.dimension not in {"angle", "length"}:
            raise RecordingError(
                text.path, f"axis {axis}", "no unit", f"one in a map, such as units: {{{meaning}: mm}}"
            )
        if meaning in numbers:
            raise RecordingError(text.path, f"axis {axis}", f"two axes for {meaning}", "one")
        numbers[meaning] = np.array([unit.to_si(value) for value in values])
        taken.append(Taken(axis, meaning, unit.name, f"stated: {poses.language}"))
    joints = sorted(int(name[1:]) for name in numbers if JOINT.fullmatch(name))
    if joints != list(range(1, len(numbers) + 1)):
        raise RecordingError(text.path, "axes", ", ".join(numbers), "joints q1 ... qn without a gap")
    texts = {"name": poses.names} if poses.names else {}
    form = f"{poses.language}, {text.encoding}"
    return Source(poses.path, form, numbers, texts, poses.lines, tuple(taken), tuple(ignored))


def _leave_out_orientation(grid: Grid, found: list[str | None]) -> None:
    """Take four columns that are a quaternion, or three angles, beside a position for its orientation: no joints."""
    if not set(AXES) <= set(found):
        return
    names = [split_unit(field)[0] for field in grid.header] or [""] * len(found)
    for joints in of_one_family(names, found):
        named = all(ANGLE.fullmatch(normal(names[i])) for i in joints)
        values = [[number_of(row[i], grid.decimal) or 0.0 for i in joints] for row in grid.rows]
        unit = bool((np.abs(np.square(values).sum(axis=1) - 1.0) < UNIT_NORM).all())
        if (len(joints) == 3 and named) or (len(joints) == 4 and unit):
            for i in joints:
                found[i] = None


def _find_others(
    grid: Grid, names: Sequence[str], stated: Sequence[ForeignUnit | None], found: list[str | None]
) -> None:
    """Find the time in a column of dates, and the temperature by its unit, where no name tells them."""
    warm = [
        i for i, unit in enumerate(stated) if found[i] is None and unit is not None and unit.dimension == "temperature"
    ]
    if len(warm) == 1 and "temperature" not in found:
        found[warm[0]] = "temperature"
    for i, name in enumerate(names):
        if normal(name) in DATES and "time" not in found and len({row[i] for row in grid.rows}) > 1:
            found[i] = "time"


def _refuse_lost(grid: Grid, names: Sequence[str], found: list[str | None], how: FileMap) -> None:
    """Refuse a column that holds a quantity in a unit that is not known, and an external axis that moves."""
    for i, name in enumerate(names):
        if found[i] is not None or not grid.header:
            continue
        if EXTERNAL.fullmatch(normal(name)) and any(one and JOINT.fullmatch(one) for one in found):
            if len({row[i] for row in grid.rows}) > 1 and name not in how.columns:
                expected = f"the joint that it is, in a map, such as columns: {{{name}: q7}}; or {name}: ignored"
                raise RecordingError(grid.path, f"column {grid.header[i]}", "an external axis that moves", expected)
            continue
        if split_unit(grid.header[i])[1] is not None:
            continue
        bare, unit = unknown_unit(grid.header[i])
        (meaning,) = meanings([bare])
        if meaning == "time" and normal(unit) in _CLOCKS and meaning not in found:
            found[i] = meaning
        elif meaning is not None and (meaning in (*AXES, *FORCES, *TORQUES) or JOINT.fullmatch(meaning)):
            known = sorted({one.name for one in UNITS.values() if one.dimension == dimension_of(meaning)})
            expected = f"a unit of {dimension_of(meaning)} ({', '.join(known)}); or `units` and `columns` in a map"
            raise RecordingError(grid.path, f"column {grid.header[i]}", f"the unit {quoted(unit)}", expected)


def _named(grid: Grid) -> tuple[list[str], list[ForeignUnit | None]]:
    width = len(grid.rows[0])
    if not grid.header:
        return [str(i + 1) for i in range(width)], [None] * width
    split = [split_unit(field) for field in grid.header]
    names, units = [name for name, _ in split], [unit for _, unit in split]
    if grid.units:
        units = [unit or unit_of(below) for unit, below in zip(units, grid.units, strict=True)]
    return names, units


def _headerless(grid: Grid, how: FileMap) -> list[str | None]:
    """Tell what the columns of a file without header hold: names, then exactly three numbers, then what is ignored."""
    if how.columns:
        return [None] * len(grid.rows[0])
    numeric = [all(number_of(row[i], grid.decimal) is not None for row in grid.rows) for i in range(len(grid.rows[0]))]
    texts = numeric.index(True) if True in numeric else len(numeric)
    if not 1 <= texts <= len(NAMES) or sum(numeric[texts : texts + 3]) != 3 or any(numeric[texts + 3 :]):
        expected = f"a header, or names and three coordinates in each row; else state `columns` in a map; {EXPORT}"
        raise RecordingError(grid.path, f"line {grid.lines[0]}", f"{len(numeric)} columns without names", expected)
    names = {1: ["point"], 2: ["group", "point"], 3: [IGNORED, "group", "point"]}[texts]
    return [*names, *AXES, *[None] * (len(numeric) - texts - 3)]


def _with_map(grid: Grid, names: Sequence[str], found: list[str | None], how: FileMap) -> list[str | None]:
    originals = list(grid.header) or list(names)
    for column, meaning in how.columns.items():
        places = [i for i, name in enumerate(names) if column in (name, originals[i], str(i + 1))]
        if not places:
            raise RecordingError(
                grid.path, f"column {quoted(column)}", "no such column", "one of " + ", ".join(originals)
            )
        found[places[0]] = meaning
    used = [meaning for meaning in found if meaning not in (None, IGNORED)]
    for meaning in used:
        if used.count(meaning) > 1:
            both = ", ".join(quoted(originals[i]) for i, one in enumerate(found) if one == meaning)
            expected = f"one column for {meaning}: state the others as `ignored` in a map"
            raise RecordingError(grid.path, f"columns {both}", f"{used.count(meaning)} columns for {meaning}", expected)
    return found


def _check_whole(grid: Grid, columns: Mapping[str, int]) -> None:
    for family in (AXES, FORCES, TORQUES):
        there = [name for name in family if name in columns]
        if there and len(there) < 3:
            missing = ", ".join(sorted(set(family) - set(there)))
            raise RecordingError(grid.path, "columns", f"{', '.join(there)} without {missing}", "all three")
    joints = sorted(int(name[1:]) for name in columns if JOINT.fullmatch(name))
    if joints and joints != list(range(1, len(joints) + 1)):
        raise RecordingError(grid.path, "columns", f"joints {joints}", "joints counted from 1 (or 0) without a gap")
    if not set(columns) & {*AXES, *FORCES, "q1"}:
        seen = ", ".join(grid.header) or f"{len(grid.rows[0])} columns without names"
        raise RecordingError(grid.path, "columns", seen, "positions x y z, joint angles or forces among them")


def _check_integers(grid: Grid, column: int, values: Float1D) -> None:
    for row in np.flatnonzero((values != np.round(values)) | (np.abs(values) > 2**53)):
        raise grid.fault(int(row), column, "an integer")


def _times(grid: Grid, column: int) -> tuple[Float1D, str]:
    """Return seconds, (m,), and how they were read: dates count from 1970 in UTC, times of day from midnight."""
    texts = [fields[column] for fields in grid.rows]
    numbers = [number_of(text, grid.decimal) for text in texts]
    ways: tuple[tuple[list[float | None], str], ...] = (
        (numbers, ""),
        dated(texts) if None in numbers else (numbers, ""),
        ([of_day(text) for text in texts], "times of day"),
    )
    for values, how in ways:
        if None not in values:
            read = [value for value in values if value is not None]
            return over_midnight(read) if how == ways[-1][1] else np.array(read), how
    found, _ = min(ways, key=lambda way: way[0].count(None))
    raise grid.fault(found.index(None), column, FORMS)


def _remarked(remarks: Sequence[str]) -> dict[Dimension, ForeignUnit]:
    """Return units stated in a remark: `Units: Millimeters, Degrees`, `All lengths in inches`."""
    found: dict[Dimension, ForeignUnit] = {}
    for remark in remarks:
        match = _STATED.search(remark)
        words = re.split(r"[,;\s]+", match.group(1)) if match else []
        for word in [*words, *_STATED_IN.findall(remark)]:
            unit = unit_of(word)
            if unit is not None:
                found.setdefault(unit.dimension, unit)
    return found


def _dimension(meaning: str, travels: Mapping[str, float] | None) -> Dimension:
    return "length" if travels is not None and meaning in travels else dimension_of(meaning)


def _converted(
    path: Path, numbers: dict[str, Float1D], taken: list[Taken], travels: Mapping[str, float] | None
) -> list[Taken]:
    """Convert all columns to SI units in place; infer units that are not stated for a family of columns at once."""
    result = {one.meaning: one for one in taken}
    joints = tuple(name for name in numbers if JOINT.fullmatch(name))
    inferred = {
        **_family(path, AXES, numbers, result, length),
        **_family(path, [name for name in joints if not _slides(result[name], travels)], numbers, result, angle),
        **_family(path, TURNS[0], numbers, result, angle),
        **_family(path, FORCES, numbers, result, force),
        **_family(path, TORQUES, numbers, result, lambda *_: (UNITS["n*m"], "the usual unit")),
    }
    if "time" in result and not result["time"].unit and not result["time"].how:
        inferred["time"] = counted(numbers["time"])
    for name, farthest in (travels or {}).items():
        inferred |= _family(path, [name], numbers, result, travel(farthest))
    if travels is None:
        refuse_two_ways(path, joints, numbers, {name: result[name].column for name in joints}, inferred)
    for meaning, one in result.items():
        dimension = _dimension(meaning, travels)
        if meaning not in numbers or dimension == "number":
            continue
        usual = next(unit for unit in UNITS.values() if unit.dimension == dimension and unit.name == SI[dimension])
        unit, how = inferred.get(meaning) or (unit_of(one.unit) or usual, one.how or "the usual unit")
        may_slide = travels is None and JOINT.fullmatch(meaning) and unit.dimension == "length"
        if unit.dimension != dimension and not may_slide:
            raise RecordingError(
                path, f"column {one.column}", f"{unit.name}, a unit of {unit.dimension}", f"a unit of {dimension}"
            )
        numbers[meaning] = np.array([unit.to_si(value) for value in numbers[meaning].tolist()])
        result[meaning] = dataclasses.replace(one, unit=unit.name, how=how)
    return list(result.values())


def _slides(one: Taken, travels: Mapping[str, float] | None) -> bool:
    """Say whether a joint slides: as the cell file says, else by its stated unit."""
    if travels is not None:
        return one.meaning in travels
    unit = unit_of(one.unit)
    return unit is not None and unit.dimension == "length"


def _family(
    path: Path,
    family: Sequence[str],
    numbers: Mapping[str, Float1D],
    taken: Mapping[str, Taken],
    infer: Inference,
) -> dict[str, tuple[ForeignUnit, str]]:
    """Return meaning -> (unit, how) for the columns of a family whose unit is not stated."""
    unstated = [name for name in family if name in numbers and not taken[name].unit]
    if not unstated:
        return {}
    known = {taken[name].unit for name in family if name in numbers and taken[name].unit}
    if len(known) == 1:
        return dict.fromkeys(unstated, (UNITS[known.pop().lower()], "the unit of the columns beside it"))
    choice = infer(path, np.column_stack([numbers[name] for name in unstated]), taken[unstated[0]].column)
    return dict.fromkeys(unstated, choice)
