"""Points, joint angles and wrenches of separate files joined to readings: by number, by order or by time."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration_core.errors import RecordingError, beyond, quoted
from calibration_core.files.names import NAME, is_name
from calibration_core.recording.dates import start_of
from calibration_core.recording.foreign.mapping import ImportMap
from calibration_core.recording.foreign.meaning import AXES, FORCES, JOINT, TORQUES
from calibration_core.recording.foreign.names import split_by, split_names
from calibration_core.recording.foreign.source import Seen, Source, read_source
from calibration_core.recording.source import file_names, sha256_of
from calibration_core.timeseries import Float1D, Float2D, Int1D, Provenance, Readings

SAME_POSTURE = 1e-3  # rad: joint angles that differ less belong to one configuration
SHOWN = 8  # columns that a message names
ONLY_POINT = "mp1"
ANGLES, WRENCHES = "joint angles", "wrenches"


@dataclasses.dataclass(frozen=True, eq=False)
class Imported:
    """Readings made of foreign files.

    Attributes:
        readings: One row per configuration, step and point.
        account: Sentences that say how rows became configurations, steps and points, and how files were joined.
    """

    readings: Readings
    sources: tuple[Source, ...]
    account: tuple[str, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of positions with their keys: configuration and step None where only the order tells."""

    source: Source
    configuration: Int1D | None
    step: Int1D | None
    point: tuple[str, ...]
    block: Int1D


def import_files(
    paths: Sequence[Path],
    how: ImportMap | None = None,
    travels: Mapping[str, float] | None = None,
    seen: Seen | None = None,
) -> Imported:
    """Read foreign files and join them.

    Args:
        paths: One file with everything, or files with positions, joint angles and wrenches; several files of positions
            are taken one after another.
        how: What is stated; None: everything is recognised.
        travels: Which joints slide, as for `read_source`; None: not known.
        seen: Where the points of a tool stand, as for `read_source`.

    Raises:
        RecordingError: Something is missing or can be read in more than one way; names the file and what to state.
    """
    how = how or ImportMap()
    account: list[str] = []
    sources = tuple(read_source(Path(path), how.of(Path(path)), travels, seen) for path in paths)
    positions = [source for source in sources if source.has_points]
    for source in positions:
        _refuse_repeated(source)
    if not positions:
        raise _lacking(sources, "no file with positions x y z", "the points that the tracker measured", "x")
    whole = positions[0] if len(positions) == 1 else _stacked(positions, account)
    rows = _keyed(whole, how, account)
    others = [source for source in sources if not source.has_points]
    joints = whole if whole.joints else _only(others, lambda source: bool(source.joints), ANGLES, paths[0])
    if joints is None:
        raise _lacking(sources, "no joint angles in any file", "columns q1 ... qn, or a robot program", "q1")
    rows = _with_postures(rows, joints, how.tolerance, account)
    wrench = whole if whole.has_wrench else _only(others, lambda source: source.has_wrench, WRENCHES, paths[0])
    _refuse_twice(whole, others)
    q_rows = _matched(rows, joints, how, account, ANGLES)
    names = sorted((name for name in joints.numbers if JOINT.fullmatch(name)), key=lambda name: int(name[1:]))
    q = np.column_stack(coupled({name: joints.numbers[name][q_rows] for name in names}, how, joints.path, account))
    force = None
    w_rows = q_rows
    if wrench is not None:
        w_rows = _matched(rows, wrench, how, account, WRENCHES)
        torque = [wrench.numbers[name][w_rows] if name in wrench.numbers else np.zeros(len(q)) for name in TORQUES]
        if TORQUES[0] not in wrench.numbers:
            account.append(f"{wrench.path.name} has no torques: they are taken as zero.")
        force = np.column_stack([*(wrench.numbers[name][w_rows] for name in FORCES), *torque])
    beside = {joints.path: (joints, q_rows)} | ({} if wrench is None else {wrench.path: (wrench, w_rows)})
    more = _besides(rows.source, list(beside.values()), account)
    return Imported(_readings(rows, q, force, more, paths, account), sources, tuple(account))


def coupled(stated: Mapping[str, Float1D], how: ImportMap, path: Path, account: list[str]) -> list[Float1D]:
    """Return the angles of the chain: those of the file, with what a map says of the others' in them.

    Raises:
        RecordingError: The map names joints that the file does not have.
    """
    for name, parts in how.joint_coupling.items():
        unknown = [one for one in (name, *parts) if one not in stated or name in parts]
        if unknown:
            raise RecordingError(path, "joint_coupling", quoted(unknown[0]), f"two of {', '.join(stated)}")
        account.append(
            f"To {name} is added {' and '.join(f'{factor:g} times {one}' for one, factor in parts.items())}."
        )
    found = []
    for name, values in stated.items():
        found.append(values + sum(factor * stated[one] for one, factor in how.joint_coupling.get(name, {}).items()))
    return found


def _refuse_twice(whole: Source, others: Sequence[Source]) -> None:
    """Refuse joint angles or forces in the file of the positions and in another one: which count is not to be told."""
    for other in others:
        for what, both in ((ANGLES, whole.joints and other.joints), (WRENCHES, whole.has_wrench and other.has_wrench)):
            if both:
                expected = "them in one file: state the columns of the other as `ignored` in a map"
                raise RecordingError(other.path, "", f"{what}, as in {whole.path.name}", expected)


def _besides(source: Source, joined: Sequence[tuple[Source, Int1D]], account: list[str]) -> dict[str, Float1D]:
    """Return time and temperature of each position, from the joined files where its own has none."""
    found = {}
    for name in ("time", "temperature"):
        places = [(source.path, source.numbers[name])] if name in source.numbers else []
        places += [
            (one.path, one.numbers[name][rows]) for one, rows in joined if name in one.numbers and one is not source
        ]
        if places:
            found[name] = places[0][1]
        if name == "temperature" and len(places) > 1:
            left = ", ".join(path.name for path, _ in places[1:])
            account.append(f"The temperature is that of {places[0][0].name}; that of {left} is not used.")
    return found


def _lacking(sources: Sequence[Source], found: str, expected: str, meaning: str) -> RecordingError:
    """Return the error where no file has what is needed; it names the columns that were not understood."""
    unknown = [(source, name) for source in sources for name in source.ignored]
    if unknown:
        listed = ", ".join(f"{quoted(name)} of {source.path.name}" for source, name in unknown[:SHOWN])
        found += f"; columns that were not understood: {listed}{', ...' if len(unknown) > SHOWN else ''}"
        expected += f"; or a map that states what they are, such as columns: {{{quoted(unknown[0][1])}: {meaning}}}"
    return RecordingError(sources[0].path, "", found, expected)


def _refuse_repeated(source: Source) -> None:
    """Refuse a row that equals an earlier one in every column: no instrument measures the same point twice alike."""
    seen: dict[tuple[object, ...], int] = {}
    columns = [*(values.tolist() for values in source.numbers.values()), *source.texts.values()]
    for row, key in enumerate(zip(*columns, strict=True)):
        if key in seen:
            found = f"the same reading as in line {source.lines[seen[key]]}"
            raise source.fault(row, source.taken[0].column, found, "every reading once")
        seen[key] = row


def _only(others: Sequence[Source], wanted: Callable[[Source], bool], what: str, first: Path) -> Source | None:
    found = [source for source in others if wanted(source)]
    if len(found) > 1:
        names = ", ".join(source.path.name for source in found)
        raise RecordingError(first, what, names, f"one file with {what}")
    return found[0] if found else None


def _stacked(positions: Sequence[Source], account: list[str]) -> Source:
    """Put files of positions one below the other; a file's name tells the configuration where its rows do not."""
    first = positions[0]
    for other in positions[1:]:
        if set(other.numbers) != set(first.numbers) or set(other.texts) != set(first.texts):
            raise RecordingError(other.path, "columns", "other columns", f"those of {first.path.name}")
    numbers = {name: np.concatenate([one.numbers[name] for one in positions]) for name in first.numbers}
    texts = {name: tuple(text for one in positions for text in one.texts[name]) for name in first.texts}
    numbered = [re.search(r"(\d+)\D*$", one.path.stem) for one in positions]
    if "configuration" not in numbers and all(numbered):
        by_file = [int(match.group(1)) for match in numbered if match is not None]
        if len(set(by_file)) == len(by_file):
            counts = [np.full(len(one), number) for one, number in zip(positions, by_file, strict=True)]
            numbers["configuration"] = np.concatenate(counts).astype(float)
            account.append("The number in each file's name is the configuration.")
    lines = tuple(line for one in positions for line in one.lines)
    files = tuple(one.path for one in positions for _ in one.lines)
    return dataclasses.replace(first, numbers=numbers, texts=texts, lines=lines, files=files)


def _keyed(source: Source, how: ImportMap, account: list[str]) -> _Rows:
    configuration = _integers(source, "configuration")
    step = _integers(source, "step")
    column = "point" if source.texts.get("point") else "name"
    labels = source.texts.get(column)
    if labels is None:
        point = tuple([ONLY_POINT] * len(source))
        account.append(f"No column names a point: all positions belong to one, called {ONLY_POINT}.")
        return _Rows(source, configuration, step, point, np.arange(len(source)))
    for row, label in enumerate(labels):
        if not is_name(label):
            raise source.fault(row, column, quoted(label), NAME)
    point = labels
    pattern = how.of(source.path).name
    if pattern is not None:
        groups, bad = split_by(re.compile(pattern), labels)
        if bad is not None:
            raise source.fault(bad, "point", quoted(labels[bad]), f"a name that matches {pattern}")
        configuration = _named_integers(source, groups["configuration"])
        step = _named_integers(source, groups["step"]) if "step" in groups else step
        point = tuple(groups.get("point", labels))
        account.append("Configuration, step and point stand in the names, as the map states.")
    elif configuration is None:
        grouped = source.texts.get("group")
        full = [f"{group}_{label}" for group, label in zip(grouped, labels, strict=True)] if grouped else labels
        parts = split_names(full)
        if parts is not None:
            configuration = np.array(parts[0])
            step = np.array(parts[1]) if parts[1] is not None else step
            point = tuple(parts[2])
            account.append(f"Configuration, step and point stand in the names: {full[0]} is {_place(parts, 0)}.")
    point = tuple(how.points.get(name, name) for name in point)
    for row, name in enumerate(point):
        if not is_name(name):
            raise source.fault(row, "point", quoted(name), NAME)
    return _Rows(source, configuration, step, point, _blocks(point))


def _place(parts: tuple[list[int], list[int] | None, list[str]], row: int) -> str:
    step = "" if parts[1] is None else f", step {parts[1][row]}"
    return f"configuration {parts[0][row]}{step}, point {parts[2][row]}"


def _blocks(point: tuple[str, ...]) -> Int1D:
    """Return the number of the step in the order of the file, (m,): a new one begins where a point comes again."""
    block, seen, result = 0, set[str](), []
    for name in point:
        if name in seen:
            block, seen = block + 1, set()
        seen.add(name)
        result.append(block)
    return np.array(result, dtype=np.int64)


def _integers(source: Source, name: str) -> Int1D | None:
    return source.numbers[name].astype(np.int64) if name in source.numbers else None


def _named_integers(source: Source, texts: Sequence[str]) -> Int1D:
    for row, text in enumerate(texts):
        if not text.isdecimal():
            raise source.fault(row, "point", quoted(text), "a number of configuration or step")
    return np.array([int(text) for text in texts], dtype=np.int64)


def _with_postures(rows: _Rows, joints: Source, tolerance: float, account: list[str]) -> _Rows:
    """Number the configurations where no file does: a new one begins where the joint angles change."""
    if rows.configuration is not None:
        return rows
    count = int(rows.block.max()) + 1
    first = np.searchsorted(rows.block, np.arange(count))  # row of each step's first position
    if joints is rows.source:
        at = first
    elif len(joints) == count:
        at = np.arange(count)
    elif "time" in joints.numbers and "time" in rows.source.numbers:
        at = _by_time(rows.source, joints, tolerance)[first]
    else:
        found = f"{count} steps of {len(set(rows.point))} points, and {len(joints)} rows of joint angles"
        expected = "as many, or a column `configuration`, or names such as C01_S2_mp1: see `name` of a map"
        raise RecordingError(rows.source.path, joints.path.name, found, expected)
    configuration = _integers(joints, "configuration")
    if configuration is not None:
        return dataclasses.replace(rows, configuration=configuration[at][rows.block])
    q = np.column_stack([values[at] for name, values in joints.numbers.items() if JOINT.fullmatch(name)])
    begins = np.r_[True, np.abs(np.diff(q, axis=0)).max(axis=1) > SAME_POSTURE]
    number = np.cumsum(begins)
    account.append(
        f"A configuration begins where the joint angles change: {number[-1]} configurations in {count} steps of "
        f"{len(set(rows.point))} points."
    )
    return dataclasses.replace(rows, configuration=number[rows.block])


def _matched(rows: _Rows, source: Source, how: ImportMap, account: list[str], what: str) -> Int1D:
    """Return the row of `source` that belongs to each position."""
    count = len(rows.source)
    if source is rows.source:
        return np.arange(count)
    configuration = _integers(source, "configuration")
    if configuration is None and rows.configuration is not None:
        numbers = _integers(source, "number")
        known = set() if numbers is None else set(numbers.tolist())
        if len(known) == len(source) and set(rows.configuration.tolist()) <= known:
            configuration = numbers
    timed = "time" in source.numbers and "time" in rows.source.numbers
    blocks = int(rows.block.max()) + 1
    join = how.join or ("number" if configuration is not None else "time" if timed else "order")
    if join == "number" and configuration is not None and rows.configuration is not None:
        return _by_number(rows, source, configuration, account, what)
    if join == "time" and timed:
        account.append(f"The {what} of {source.path.name} are joined by time.")
        return _by_time(rows.source, source, how.tolerance)
    if join == "order" and len(source) == blocks:
        account.append(f"The {what} of {source.path.name} are joined in order: {blocks} rows for {blocks} steps.")
        return rows.block
    if join == "order" and rows.configuration is not None and len(source) == len(set(rows.configuration.tolist())):
        order = {number: i for i, number in enumerate(dict.fromkeys(rows.configuration.tolist()))}
        account.append(f"The {what} of {source.path.name} are joined in order, a row for each configuration.")
        return np.array([order[number] for number in rows.configuration.tolist()], dtype=np.int64)
    found = f"{len(source)} rows of {what} for {blocks} steps"
    raise RecordingError(source.path, "", found, f"as many rows, or numbers or times in both files (join: {join})")


def _by_number(rows: _Rows, source: Source, configuration: Int1D, account: list[str], what: str) -> Int1D:
    step = _integers(source, "step")
    both = step is not None and rows.step is not None
    keys = _keys(configuration, step if both else None)
    wanted = _keys(rows.configuration, rows.step if both else None)
    index = {key: i for i, key in reversed(list(enumerate(keys)))}
    if not both and len(index) != len(keys) and what == WRENCHES:
        expected = "a row for each configuration, or a column `step` in both files"
        raise RecordingError(source.path, "", f"several rows of {what} for one configuration", expected)
    missing = next((i for i, key in enumerate(wanted) if key not in index), None)
    if missing is not None:
        found = ", step ".join(map(str, wanted[missing][: 1 + both]))
        raise rows.source.fault(missing, "configuration", found, f"one of those in {source.path.name}")
    account.append(f"The {what} of {source.path.name} are joined by configuration{' and step' if both else ''}.")
    return np.array([index[key] for key in wanted], dtype=np.int64)


def _keys(configuration: Int1D | None, step: Int1D | None) -> list[tuple[int, int]]:
    """Return (configuration, step) of each row; without steps, 0 in their place."""
    if configuration is None:
        return []
    steps = [0] * len(configuration) if step is None else step.tolist()
    return list(zip(configuration.tolist(), steps, strict=True))


def _by_time(rows: Source, source: Source, tolerance: float) -> Int1D:
    order = np.argsort(source.numbers["time"], kind="stable")
    times = source.numbers["time"][order]
    wanted = rows.numbers["time"]
    right = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(times) - 1)
    nearest = np.where(np.abs(times[left] - wanted) <= np.abs(times[right] - wanted), left, right)
    gap = np.abs(times[nearest] - wanted)
    if gap.max() > tolerance:
        row = int(np.argmax(gap))
        expected = f"a row of {source.path.name} within {tolerance:g} s (tolerance in a map)"
        raise rows.fault(row, "time", f"{beyond(float(gap[row]), tolerance, 3)} s to the nearest", expected)
    return np.asarray(order[nearest], dtype=np.int64)


def _readings(
    rows: _Rows,
    q: Float2D,
    wrench: Float2D | None,
    more: Mapping[str, Float1D],
    paths: Sequence[Path],
    account: list[str],
) -> Readings:
    source = rows.source
    configuration = rows.block + 1 if rows.configuration is None else rows.configuration
    step = rows.step if rows.step is not None else _counted(configuration, rows.point)
    if rows.step is None and step.any():
        account.append("A point that comes again in a configuration begins its next step.")
    if step.min() > 0:  # foreign files count steps from 1
        lowest = {c: int(step[configuration == c].min()) for c in set(configuration.tolist())}
        step = step - np.array([lowest[c] for c in configuration.tolist()])
        account.append("Steps are counted from 0.")
    points = tuple(dict.fromkeys(rows.point))
    steps = len(set(_keys(configuration, step)))
    shown = ", ".join(points[:8]) + (", ..." if len(points) > 8 else "")
    configurations = len(set(configuration.tolist()))
    account.append(
        f"{configurations} configurations, {steps} steps, {len(points)} points ({shown}), {q.shape[1]} joints."
    )
    keys: dict[tuple[int, int, str], int] = {}
    for row, key in enumerate(zip(configuration.tolist(), step.tolist(), rows.point, strict=True)):
        if key in keys:
            first = keys[key]
            found = f"configuration {key[0]}, step {key[1]}, point {key[2]} as in line {source.lines[first]}"
            found += f" of {source.file(first).name}" if source.file(first) != source.file(row) else ""
            raise source.fault(row, "point", found, "every reading once")
        keys[key] = row
    order = np.arange(len(q))
    if not _in_order(configuration, step):
        order = np.lexsort((order, step, configuration))
    unknown: Float1D = np.full(len(q), np.nan)
    sources = [Path(path) for path in paths]
    files = {name: sha256_of(path) for name, path in zip(file_names(sources), sources, strict=True)}
    readings = Readings(
        points=points,
        configuration=configuration,
        step=step,
        point=np.array([points.index(name) for name in rows.point], dtype=np.int64),
        q=q,
        position=np.column_stack([source.numbers[name] for name in AXES]),
        wrench=wrench,
        time=more.get("time", unknown),
        temperature=more.get("temperature", unknown),
        provenance=Provenance(str(paths[0]), "csv", files, {"rows": len(q)}, start_of(more.get("time", unknown))),
    )
    return readings.select(order)


def _counted(configuration: Int1D, point: tuple[str, ...]) -> Int1D:
    seen: dict[tuple[int, str], int] = {}
    result = []
    for key in zip(configuration.tolist(), point, strict=True):
        seen[key] = seen.get(key, -1) + 1
        result.append(seen[key])
    return np.array(result, dtype=np.int64)


def _in_order(configuration: Int1D, step: Int1D) -> bool:
    """Tell whether each configuration stands in one run of rows and its steps never decrease."""
    runs = 1 + int(np.count_nonzero(np.diff(configuration)))
    same = np.diff(configuration) == 0
    return runs == len(set(configuration.tolist())) and bool(np.all(np.diff(step)[same] >= 0))
